"""Values from files fit the annotations of what they are for, or are refused by name."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest

from lensshift.capture.opening import open_rig
from lensshift.core.errors import DataError
from lensshift.core.settings import built, fit, parse_toml, read_text
from lensshift.io.calibration_file import load_calibration
from lensshift.optics.lens_file import load_lens
from lensshift.optics.zmx import load_zmx
from lensshift.pipeline import load_experiment
from lensshift.scene import load_scene

Pair = tuple[float, float]


@pytest.mark.parametrize(
    ("value", "kind", "found"),
    [
        (True, bool, True),
        (2, int, 2),
        (2, float, 2.0),
        (2.5, float, 2.5),
        ("a", str, "a"),
        ("a", Path, Path("a")),
        ("on", Literal["on", "off"], "on"),
        ([1, 2], Pair, (1.0, 2.0)),
        ([], tuple[int, ...], ()),
        ([[1, 2], [3, 4]], tuple[Pair, ...], ((1.0, 2.0), (3.0, 4.0))),
        (1, float | Pair | None, 1.0),
        ([1, 2], float | Pair | None, (1.0, 2.0)),
        (None, float | None, None),
    ],
)
def test_a_value_of_the_right_type_is_taken(value: object, kind: Any, found: object) -> None:
    taken = fit(value, kind, "a")
    assert taken == found
    assert type(taken) is type(found)


@pytest.mark.parametrize(
    ("value", "kind", "said"),
    [
        ("false", bool, "a: expected bool, got 'false'"),
        (1, bool, "a: expected bool, got 1"),
        (1.5, int, "a: expected int, got 1.5"),
        (1.0, int, "a: expected int, got 1.0"),
        (True, int, "a: expected int, got True"),
        (True, float, "a: expected float, got True"),
        ("2", float, "a: expected float, got '2'"),
        (10**400, float, "a: expected float, got 1000"),
        (2, str, "a: expected str, got 2"),
        (2, Path, "a: expected str, got 2"),
        ("of", Literal["on", "off"], "a: expected on, off, got 'of'"),
        ([1], Pair, "a: expected [float, float], got [1]"),
        ([1, "2"], Pair, "a[1]: expected float, got '2'"),
        ([[1, 2], [3, True]], tuple[Pair, ...], "a[1][1]: expected float, got True"),
        ([1], float | Pair | None, "a: expected float or [float, float], got [1]"),
    ],
)
def test_a_value_of_another_type_is_refused(value: object, kind: Any, said: str) -> None:
    with pytest.raises(DataError) as caught:
        fit(value, kind, "a")
    assert str(caught.value).startswith(said)


@dataclass
class Group:
    """Some settings."""

    number: int
    tool: Any = None
    on: bool = False


class Tool:
    """The same of a class that is no dataclass."""

    def __init__(self, number: int, tool: Any = None, on: bool = False) -> None:
        self.told = (number, tool, on)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tool) and self.told == other.told


def make(number: int, tool: Any = None, on: bool = False) -> Group:
    return Group(number, tool, on)


@pytest.mark.parametrize("kind", [Group, Tool, make])
@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"number": 1, "off": True}, "t.off: is not known, expected number, on"),
        ({"number": 1, "tool": 3}, "t.tool: is not known"),
        ({"on": True}, "t.number: expected this entry, which is missing"),
        ({"number": "1"}, "t.number: expected int, got '1'"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(
    table: dict[str, object], said: str, kind: Callable[..., object]
) -> None:
    with pytest.raises(DataError) as caught:
        built(kind, table, "t")
    assert str(caught.value).startswith(said)
    assert built(kind, {"number": 3, "on": True}, "t") == kind(3, None, True)


@pytest.mark.parametrize("number", [2**63 - 1, -(2**63), 0])
def test_integers_of_64_bits_are_taken_and_no_others(number: int) -> None:
    assert parse_toml(f"[a]\nb = [{number}]") == {"a": {"b": [number]}}
    beyond = number + (1 if number > 0 else -1)
    if number:
        with pytest.raises(DataError, match=r"a\.b\[0\]: expected an integer within 64 bits"):
            parse_toml(f"[a]\nb = [{beyond}]")


@pytest.mark.parametrize(
    "load",
    [read_text, open_rig, load_experiment, load_scene, load_lens, load_zmx, load_calibration],
)
def test_nobody_waits_for_a_pipe(tmp_path: Path, load: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="expected a"):
        load(tmp_path / "pipe")
