"""Glass catalogues as optical design programs have them (.agf)."""

from __future__ import annotations

import re
from pathlib import Path

from lensshift.core.errors import DataError, warn_quality
from lensshift.core.settings import settings_of
from lensshift.optics.glass import (
    CONSTANT_COUNTS,
    D_UM,
    NO_CHANGE,
    REFERENCE_TEMPERATURE_C,
    SAID,
    Glass,
    add_glasses,
    index_of,
)

_FORMULAS = {
    1: "schott", 2: "sellmeier 1", 3: "herzberger", 4: "sellmeier 2", 5: "conrady",
    6: "sellmeier 3", 7: "handbook 1", 8: "handbook 2", 9: "sellmeier 4", 10: "extended",
    11: "sellmeier 5", 12: "extended 2", 13: "extended 3",
}  # fmt: skip
_CONTRADICTS = 0.01  # between what constants give and what is stated: more than any rounding


def load_glass_catalogue(path: str | Path) -> dict[str, Glass]:
    """Read a glass catalogue and make its glasses known to lens files by their names.

    They go before those of the package, and behind those of catalogues that were loaded before.

    Parameters
    ----------
    path : text in UTF-8, UTF-16 or ISO-8859-1; entries NM, CD, TD, LD count, with the
        lines in which they go on

    Returns
    -------
    all glasses of the file by name, in upper case

    Raises
    ------
    DataError
        If the file is missing or has no glass that can be read: with file and line.

    Warns
    -----
    QualityWarning
        Of glasses that are left out, since a number or a formula is wrong: with their lines; of
        those that replace another glass of the package.
    """
    text = decode(path)
    wrong: list[DataError] = []
    doubtful: list[str] = []
    with settings_of(path):
        glasses = parse_agf(text, wrong, doubtful)
        if not glasses:
            raise wrong[0] if wrong else DataError("expected glasses (NM), got none")
        add_glasses(glasses, behind=True)
    for told, what in ((wrong, "are left out"), (doubtful, "may be wrong")):
        if told:
            first = "; ".join(str(one) for one in told[:SAID])
            more = f"; and {len(told) - SAID} more" if len(told) > SAID else ""
            warn_quality(f"{path}: {len(told)} of its glasses {what}: {first}{more}")
    return glasses


def parse_agf(
    text: str, wrong: list[DataError] | None = None, doubtful: list[str] | None = None
) -> dict[str, Glass]:
    """Return the glasses of a catalogue by name; see `load_glass_catalogue`.

    What is wrong with those that cannot be read is added to `wrong`, or raised without it; where
    constants and the n_d of an entry contradict each other that is added to `doubtful`.
    """
    glasses: dict[str, Glass] = {}
    lines: dict[str, tuple[int, list[str]]] = {}
    words: list[str] = []
    for number, line in enumerate([*text.splitlines(), "NM"], start=1):
        key, *rest = line.split() or [""]  # at spaces or tabs
        if re.match(r"[-+]?\.?\d", key):  # the entry goes on in this line
            words += [key, *rest]
            continue
        words = rest
        if key == "NM":
            if "NM" in lines:
                try:
                    name, glass = _glass(lines)
                    if glasses.setdefault(name, glass) != glass and doubtful is not None:
                        at = f"line {lines['NM'][0]}"
                        doubtful.append(f"{at}: {name} is there twice, the first is taken")
                    elif doubtful is not None:
                        doubtful += _contradiction(glass, *lines["NM"])
                except DataError as error:
                    if wrong is None:
                        raise
                    wrong.append(error)
            lines = {}
        if key in ("NM", "CD", "TD", "LD", "GC"):
            lines[key] = (number, words)
    return glasses


def _glass(lines: dict[str, tuple[int, list[str]]]) -> tuple[str, Glass]:
    number, words = lines["NM"]
    try:
        name, formula = words[0].upper(), _FORMULAS[int(float(words[1]))]
        number, constants = lines["CD"]
        values = [float(word) for word in constants[: CONSTANT_COUNTS[formula]]]
        number, thermal = lines.get("TD", (number, []))
        # Without all of them, and with "_" or "-" for a number, the change is not known.
        known = len(thermal) >= 6 and not {"_", "-"} & set(thermal[:7])
        number, span = lines["LD"]
        low_um, high_um = (float(word) for word in span[:2])
        return name, Glass(
            formula,
            tuple(values),
            tuple(float(word) for word in thermal[:6]) if known else NO_CHANGE,
            float(thermal[6]) if known and len(thermal) > 6 else REFERENCE_TEMPERATURE_C,
            (1e3 * low_um, 1e3 * high_um),
            " ".join(lines.get("GC", (0, []))[1]),
        )
    except (ValueError, IndexError, KeyError) as error:
        raise DataError(
            f"expected a glass as NM name formula, CD constants, LD range, got {words}: {error}",
            field=f"line {number}",
        ) from error


def _contradiction(glass: Glass, line: int, words: list[str]) -> list[str]:
    """Return in words that the constants of a glass do not give the n_d of its entry, if so."""
    try:
        stated = float(words[3])
    except (ValueError, IndexError):
        return []
    if stated <= 1.0 or not glass.range_nm[0] <= 1e3 * D_UM <= glass.range_nm[1]:
        return []  # none is written
    found = index_of(glass, D_UM)
    if abs(found - stated) < _CONTRADICTS:
        return []
    return [f"line {line}: the constants of {words[0]} give n_d {found:.4g}, its entry {stated:g}"]


def decode(path: str | Path) -> str:
    """Return the text of a file of a design program, whatever its encoding.

    Raises
    ------
    DataError
        If the file cannot be read or is no text.
    """
    if Path(path).exists() and not Path(path).is_file():
        raise DataError("cannot read: expected a file, not a folder, device or pipe", source=path)
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read: {error.strerror or error}", source=path) from error
    try:
        even = raw[: len(raw) // 2 * 2]  # a file of UTF-16 may end within a character
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return even.decode("utf-16")
        if b"\0" in raw[:200]:  # UTF-16 without its mark: every other byte of plain text is 0
            return even.decode("utf-16-be" if raw[:1] == b"\0" else "utf-16-le")
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            return raw.decode("iso-8859-1")  # knows every byte
    except UnicodeDecodeError as error:
        raise DataError("expected a text file in UTF-8 or UTF-16", source=path) from error
