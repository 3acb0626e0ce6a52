"""Look at the built site: every public name has a page, every internal link leads somewhere."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

sys.path.insert(0, str(Path(__file__).resolve().parent))
from reference import documented


class Page(HTMLParser):
    """The links, anchors and loaded files of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take note of what a tag refers to."""
        told = {name: value or "" for name, value in attrs}
        self.anchors |= {told[name] for name in ("id", "name") if name in told}
        if tag == "a" and "href" in told:
            self.links.append(told["href"])
        if "src" in told:
            self.loaded.append(told["src"])
        if tag == "link" and told.get("rel") in ("stylesheet", "icon", "preload"):
            self.loaded.append(told["href"])


def broken_links(site: Path) -> list[str]:
    """Return internal links that lead nowhere, and files that are loaded from elsewhere."""
    pages = {path.resolve(): Page(path) for path in sorted(site.rglob("*.html"))}
    problems = []
    for path, page in pages.items():
        here = path.relative_to(site.resolve())
        for link in (*page.links, *page.loaded):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https"):
                if link in page.loaded:
                    problems.append(f"{here}: loads {link}")
                continue
            if parts.scheme:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                problems.append(f"{here}: {link} does not exist")
            elif target in pages and unquote(parts.fragment) not in pages[target].anchors:
                problems.append(f"{here}: {link} has no such place")
    return problems


def missing_names(site: Path) -> list[str]:
    """Return public names without a page of their own."""
    pages = {path.stem for path in (site / "generated" / "api" / "names").glob("*.html")}
    return [f"{name} has no page" for name, page in documented().items() if page not in pages]


def main() -> None:
    """Print what is wrong, and exit with 1 if anything is."""
    site = Path(sys.argv[1])
    problems = broken_links(site) + missing_names(site)
    for problem in problems:
        print(problem)
    count = len(list(site.rglob("*.html")))
    print(f"{count} pages, {len(problems)} problems")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
