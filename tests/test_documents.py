"""README and docs hold what they promise: commands and snippets run, links lead somewhere."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from lensshift.cli.app import app

ROOT = Path(__file__).resolve().parents[1]
WRITTEN_BY_THE_BUILD = {"_site", "generated", "gallery", "_ext", "_static", "_templates"}
DOCUMENTS = [
    ROOT / "README.md",
    *(
        path
        for path in sorted((ROOT / "docs").rglob("*.md"))
        if not WRITTEN_BY_THE_BUILD & set(path.relative_to(ROOT / "docs").parts)
    ),
]
GALLERY = sorted((ROOT / "examples" / "gallery").glob("plot_*.py"))

# Lines that are not run, with the reason.
NOT_RUN = {
    r"pip install|python3 -m venv|\.venv/bin/activate": "sets up an environment",
    r"^lensshift live ": "runs until Ctrl-C (tests/live)",
    r"^lensshift emulate ": "runs until Ctrl-C (tests/capture)",
    r"rig\.toml|--devices|scan\.nc|calibration\.json|shot\.nc": "needs a rig (tests/pipeline)",
    r"mdsp_eia|REFERENCE_FOLDER|^python benchmarks/|^python examples/": "test_examples",
    r"^lensshift (reproduce|lens optimise|lens tolerance)|--workers": "minutes: has its own test",
    r"recording\.pcap|mine\.zmx|--window 4 --every|sr\.mcap": "files of the reader's own",
    r"^\$ |^bicubic |^shift-and-add |^auto |^wrote ": "output",
    r"photo": "files of the reader's own (tests/cli/test_cli_chart.py)",
    r"frames/|planned\.csv": "files of the reader's own",
}  # fmt: skip
# Snippets that show an interface of the reader's own.
NOT_RUN_PYTHON = r"open_rig\(|my_grab|as rig:"


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the code of a document in its order: ("sh" | "python", text)."""
    lines = path.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        fence = re.match(r"^(```|:::+)\s*\{?(\w*)", lines[number])
        if fence and fence[1] == "```":
            end = next(k for k in range(number + 1, len(lines)) if lines[k].startswith("```"))
            if fence[2] in ("python", "toml"):
                yield fence[2], "\n".join(lines[number + 1 : end])
            number = end + 1
            continue
        before = lines[number - 1].strip() if number else ""
        if lines[number].startswith("    ") and not before:
            end = number
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
                end += 1
            text = "\n".join(line[4:] for line in lines[number:end]).strip()
            yield ("python" if re.match(r"(from|import|\w+ = lensshift\.)", text) else "sh"), text
            number = end
            continue
        number += 1


def commands(text: str) -> Iterator[str]:
    """Yield the commands of a shell block, one line each."""
    for line in text.replace("\\\n", " ").splitlines():
        if line.strip() and not line.startswith(("=", "y_k", "u =", "point =", "offset =", "Y_k")):
            yield line.strip()


def told_by(document: Path) -> list[str]:
    return [line for kind, text in blocks(document) if kind == "sh" for line in commands(text)]


def lensshift_calls(line: str) -> Iterator[list[str]]:
    """Yield the words of each call of `lensshift` on a line, without comments."""
    for part in re.split(r"&&|;|\|", re.sub(r"(^|\s)#.*$", "", line)):
        words = shlex.split(part)
        if words and Path(words[0]).name == "lensshift":
            yield words[1:]


@cache
def all_commands() -> Any:
    return get_command(app)


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_command_names_verbs_and_options_that_exist(document: Path) -> None:
    for line in told_by(document):
        for words in lensshift_calls(line):
            verb = all_commands()
            while words and words[0] in getattr(verb, "commands", {}):
                verb = verb.commands[words.pop(0)]
            assert not getattr(verb, "commands", {}) or words in (["--help"], []), line
            known = {name for one in verb.params for name in (*one.opts, *one.secondary_opts)}
            options = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
            assert options <= known | {"--help"}, line


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_a_new_environment_gets_lensshift_from_the_clone(document: Path) -> None:
    for kind, text in blocks(document):
        if kind == "sh" and "-m venv .venv" in text:
            wanted = re.findall(r"\.venv/bin/pip install (?:-e )?'?([^\s']+)", text)
            assert wanted, text
            assert all(one.startswith(".") for one in wanted), "no index has a package lensshift"


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_snippet_is_python(document: Path) -> None:
    for kind, text in blocks(document):
        if kind == "python":
            ast.parse(text)


def test_the_search_for_code_finds_some() -> None:
    text = "\n".join(line for document in DOCUMENTS for line in told_by(document))
    assert text.count("lensshift ") > 90
    assert sum(kind == "python" for one in DOCUMENTS for kind, _ in blocks(one)) > 12


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_links_to_files_lead_somewhere(document: Path) -> None:
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if not re.match(r"https?:|mailto:", target):
            assert (document.parent / target).exists(), target
    for target in re.findall(r"\{doc\}`(?:[^`<]*<)?([^`>]+)>?`", text):
        if "generated" not in target and "gallery" not in target:
            assert (document.parent / f"{target}.md").exists(), target


def test_every_page_is_in_the_contents() -> None:
    contents = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split()
    pages = [path.relative_to(ROOT / "docs") for path in DOCUMENTS[1:]]
    listed = {str(page.with_suffix("")) for page in pages if page.parts[0] != "decisions"}
    assert listed - set(contents) == {"index"}


MESSAGES = ROOT / "docs" / "troubleshooting.md"


def explained() -> list[str]:
    lines = re.findall(r"^\*\*`.*$", MESSAGES.read_text(encoding="utf-8"), re.M)
    return [message for line in lines for message in re.findall(r"\*\*`([^`]+)`\*\*", line)]


def test_messages_that_are_explained_exist() -> None:
    source = " ".join(
        re.sub(r'["\']\s*\n?\s*f?["\']', "", path.read_text(encoding="utf-8"))
        for path in (ROOT / "src").rglob("*.py")
    )
    source = " ".join(source.split())
    assert len(explained()) > 12
    for message in explained():
        for part in message.split("..."):
            if len(part.strip()) > 3:
                assert part.strip() in source, message


def shown(told: ast.expr) -> str:
    """Return a message as it is written in the source, with "..." for what varies."""
    if isinstance(told, ast.JoinedStr):
        return "".join(shown(part) for part in told.values)
    return str(told.value) if isinstance(told, ast.Constant) else "..."


def warned_of(folder: str) -> Iterator[str]:
    for path in sorted((ROOT / "src" / "lensshift" / folder).rglob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and call.args:
                name = ast.unparse(call.func).rpartition(".")[2]
                if name in ("warn_quality", "_warn"):
                    yield shown(call.args[0])


@pytest.mark.parametrize("folder", ["reconstruction", "registration"])
def test_warnings_about_a_result_are_explained(folder: str) -> None:
    known = [".*".join(map(re.escape, message.split("..."))) for message in explained()]
    # What begins with another message is explained as that one, and so is "frame ...: ...".
    told = [one for one in warned_of(folder) if re.match(r"[^.]{9}", one)]
    assert len(told) > 4
    assert [one for one in told if not any(re.search(message, one) for message in known)] == []


def place_of(document: Path, tmp_path: Path) -> dict[str, str]:
    """Make the commands of a page in a folder, with what README assumes; return the environment."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, options in (("lensshift", "-m lensshift "), ("python", "")):
        shim = programs / name
        shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" {options}"$@"\n', encoding="utf-8")
        shim.chmod(0o755)
    folder = tmp_path / "work"
    folder.mkdir()
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("__*"))
    path = os.pathsep.join([str(programs), os.environ.get("PATH", "")])
    return dict(os.environ) | {"PATH": path, "MPLBACKEND": "agg"}


# What a page takes for granted: made by another page, or by the first command of README.
BEFORE = {
    "README.md": [
        "lensshift run examples/four_boxes.toml --out out",
        "cp out/burst.nc .",
        """python -c "
import lensshift
from dataclasses import replace
burst = replace(lensshift.load_burst('burst.nc'), phasors=None)
lensshift.write_recording('recording.nc', 72, (burst for _ in range(18)))
" """,
    ],
    "docs/point-clouds.md": [],
    "docs/lens.md": ["lensshift simulate four_boxes --lens petzval_b --element 1 -o burst.nc"],
    "docs/registration.md": [
        "lensshift simulate four_boxes -o burst.nc && lensshift convert burst.nc frames.tif"
    ],
    "docs/gradients.md": [],
}
PYTHON_BEFORE = {
    "README.md": """
import numpy as np
from lensshift.pipeline import demo_burst
demo, _ = demo_burst()
frames, offset_px = demo.amplitude, demo.offset_px
frame = frames[0]
""",
    "docs/lens.md": "import lensshift\nburst = lensshift.load_burst('burst.nc')\n",
    "docs/registration.md": (
        "import lensshift\nburst = lensshift.load_burst('burst.nc')\ncentre_mm = (3.0, 3.0)\n"
    ),
    "docs/point-clouds.md": "import lensshift\nburst = lensshift.load_burst('burst.nc')\n",
    "docs/howto/scenes.md": "",
}


def reason_not_to_run(line: str) -> str | None:
    return next((why for what, why in NOT_RUN.items() if re.search(what, line)), None)


def runs(line: str) -> bool:
    return not reason_not_to_run(line) and bool(re.search(r"lensshift |printf", line))


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_some_of_the_code_on_a_page_runs_or_all_of_it_says_why_not(document: Path) -> None:
    told = told_by(document)
    snippets = [text for kind, text in blocks(document) if kind == "python"]
    if not any(not re.search(NOT_RUN_PYTHON, text) for text in snippets):
        assert not told or any(map(runs, told)) or all(map(reason_not_to_run, told))


def write_files(document: Path, folder: Path) -> None:
    """Write the files that a page shows, under the name that it says after them."""
    names = re.findall(r"[Ss]aved as `([\w.]+\.toml)`", document.read_text(encoding="utf-8"))
    shown = [text for kind, text in blocks(document) if kind == "toml"]
    for name, text in zip(names, shown, strict=False):
        (folder / name).write_text(text, encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_commands_and_snippets_run(document: Path, tmp_path: Path) -> None:
    environment = place_of(document, tmp_path)
    folder = tmp_path / "work"
    write_files(document, folder)
    if not any(blocks(document)):
        pytest.skip("no code on this page")
    script = [*BEFORE.get(named(document), [])]
    code = PYTHON_BEFORE.get(named(document), "")
    for line in script:
        subprocess.run(["bash", "-c", line], cwd=folder, env=environment, check=True)
    for kind, text in blocks(document):
        if kind == "sh":
            for line in commands(text):
                if not runs(line):
                    continue
                done = subprocess.run(
                    ["bash", "-c", line], cwd=folder, env=environment,
                    capture_output=True, text=True, check=False,
                )  # fmt: skip
                assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        elif kind == "python" and not re.search(NOT_RUN_PYTHON, text):
            code += text + "\n"  # a page is one session
            (folder / "page.py").write_text(code, encoding="utf-8")
            done = subprocess.run(
                [sys.executable, "page.py"], cwd=folder, env=environment,
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, f"{text}\n{done.stderr}"


def test_the_gallery_shows_its_scripts_in_the_order_of_their_numbers() -> None:
    numbers = [int(path.name.split("_")[1]) for path in GALLERY]  # sorted by name, as the site does
    assert numbers == list(range(1, len(GALLERY) + 1))


@pytest.mark.slow
@pytest.mark.parametrize("script", GALLERY, ids=lambda path: path.stem)
def test_gallery_scripts_draw(script: Path, tmp_path: Path) -> None:
    code = (
        "import runpy, sys\nfrom matplotlib.figure import Figure\n"
        f"found = runpy.run_path({str(script)!r})\n"
        "drawn = [one for one in found.values() if isinstance(one, Figure)]\n"
        "for number, one in enumerate(drawn): one.savefig(f'{number}.png')\n"
        "sys.exit(not drawn)"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_examples_in_docstrings_hold() -> None:
    import doctest
    from importlib import import_module

    attempted = 0
    for path in sorted((ROOT / "src" / "lensshift").rglob("*.py")):
        if ">>>" not in path.read_text(encoding="utf-8"):
            continue
        parts = path.relative_to(ROOT / "src").with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        found = doctest.testmod(import_module(name))
        assert found.failed == 0, name
        attempted += found.attempted
    assert attempted > 5
