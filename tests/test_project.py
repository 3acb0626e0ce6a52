"""What people look for in a project is there and says the same everywhere."""

import re
import tomllib
from pathlib import Path

import pytest

import lensshift

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_one_version_everywhere() -> None:
    version = PROJECT["version"]
    assert lensshift.__version__ == version
    assert re.search(rf"^version: {re.escape(version)}$", text_of("CITATION.cff"), re.M)
    assert f"## [{version}]" in text_of("CHANGELOG.md")


def test_extras_that_are_promised_exist() -> None:
    promised = {"optiland", "live", "cluster", "napari", "fits", "notebook", "docs", "dev", "test"}
    assert promised <= set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize("minor", [11, 12, 13])
def test_python_versions_are_named(minor: int) -> None:
    assert f"Programming Language :: Python :: 3.{minor}" in PROJECT["classifiers"]


@pytest.mark.parametrize(
    "name",
    ["CITATION.cff", "SECURITY.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "LICENSE",
     ".github/PULL_REQUEST_TEMPLATE.md", ".github/ISSUE_TEMPLATE/bug.yml", ".ci/release"],
)  # fmt: skip
def test_files_that_people_look_for(name: str) -> None:
    assert len(text_of(name)) > 100


def test_the_paper_is_named_with_title_and_venue_wherever_it_is_named() -> None:
    sources = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "src").rglob("*.py")]
    named = [
        path
        for path in sources
        if "Optical lens-shift design" in path.read_text(encoding="utf-8")
        and not {"_site", "generated", "gallery"} & set(path.parts)
    ]
    assert len(named) >= 3
    for path in named:
        words = " ".join(path.read_text(encoding="utf-8").replace('"', " ").split())
        assert "increasing spatial resolution of 3D ToF cameras" in words, path
        assert "Advanced Optical Technologies" in words, path
