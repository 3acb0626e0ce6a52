"""Shifts from CSV and JSON, and what is wrong with bad ones, line by line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lensshift.core.errors import DataError
from lensshift.io import load_offsets

finite = st.floats(-1e6, 1e6, allow_nan=False)


@given(pairs=st.lists(st.tuples(finite, finite), min_size=1, max_size=9), data=st.data())
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_csv_and_json_say_the_same(
    pairs: list[tuple[float, float]], data: st.DataObject, tmp_path: Path
) -> None:
    order = data.draw(st.permutations(range(len(pairs))))
    lines = [f"{frame},{pairs[frame][1]!r}, {pairs[frame][0]!r}" for frame in order]
    (tmp_path / "a.csv").write_text("frame,col,row\n\n" + "\n".join(lines) + "\n\n")
    (tmp_path / "a.json").write_text(f'{{"offset_px": {[list(pair) for pair in pairs]}}}')
    np.testing.assert_array_equal(load_offsets(tmp_path / "a.csv").offset_px, pairs)
    np.testing.assert_array_equal(load_offsets(tmp_path / "a.json").offset_px, pairs)


def test_deviation_and_source(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\ufeffrow,col,sigma_row,sigma_col\n0,0.5,0.01,0.02\n")
    table = load_offsets(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.offset_sigma_px, [[0.01, 0.02]])
    assert table.offset_source == "planned"
    (tmp_path / "a.json").write_text(
        '{"offset_px": [[0, 1]], "offset_sigma_px": [[1, 2]], "offset_source": "registered"}'
    )
    table = load_offsets(tmp_path / "a.json")
    np.testing.assert_array_equal(table.offset_sigma_px, [[1, 2]])
    assert table.offset_source == "registered"
    (tmp_path / "a.json").write_text('{"offset_px": [[0, 1]]}')
    assert load_offsets(tmp_path / "a.json").offset_sigma_px is None


@pytest.mark.parametrize(
    "content",
    [
        "# of the stage, in px\nrow,col\n-.25,.5\n# moved\n1,2\n",
        "Row;Col\n-0,25;0,5\n1;2\n",
        "row\tcol\r\n-0.25\t0.5\r\n1\t2\r\n",
        '"frame";"row";"col"\n1;1;2\n;;\n0;-0,25;0,5\n',
    ],
)
def test_tables_as_other_programs_write_them(tmp_path: Path, content: str) -> None:
    for name in ("a.csv", "a.txt"):
        (tmp_path / name).write_text(content)
        np.testing.assert_array_equal(
            load_offsets(tmp_path / name).offset_px, [[-0.25, 0.5], [1, 2]]
        )


def test_rows_are_numbered_as_pandas_writes_them(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(",row,col\n1,2.0,3.0\n0,0.5,1.0\n")
    np.testing.assert_array_equal(load_offsets(tmp_path / "a.csv").offset_px, [[0.5, 1], [2, 3]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty"),
        ("\n", "line 1: expected the header"),
        ("x,y\n1,2\n", "line 1: expected the header"),
        ("row col\n1 2\n", "line 1: expected the header"),
        ("row,col\n0,5,0,5\n", "line 2: expected 2 values, got 4"),
        ("row,col,sigma_rwo\n1,2,3\n", "line 1: expected the header"),
        ("row,col,col\n1,2,3\n", "line 1: expected the header"),
        ("row,col,sigma_row\n1,2,3\n", "line 1: expected sigma_row and sigma_col"),
        ("row,col\n", "row: expected one line a frame"),
        ("row,col\n1,2\n3\n", "line 3: expected 2 values, got 1"),
        ("row,col\n1,2\n\n3,4,5\n", "line 4: expected 2 values, got 3"),
        ("row,col\n1,zwei\n", "line 2, col: expected a finite number, got 'zwei'"),
        ("row,col\nnan,1\n", "line 2, row: expected a finite number"),
        ("row,col\n1,inf\n", "line 2, col: expected a finite number"),
        ("frame,row,col\n0,1,1\n0,2,2\n", "frame: expected each number from 0 to 1 once"),
        ("frame,row,col\n1,1,1\n2,2,2\n", "frame: expected each number from 0 to 1 once"),
        ("frame,row,col\n0.5,1,1\n", "frame: expected each number from 0 to 0 once"),
        ('row,col\n"1,2\n', "line 2"),
    ],
)
def test_bad_csv_names_the_line(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content)
    assert said in message_of_loading(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"offset_px": [[1, 2]\n', "not JSON: Expecting ',' delimiter (line 2"),
        ("[[1, 2]]", "offset_px: expected {"),
        ("{}", "offset_px: expected {"),
        ('{"offset_px": []}', 'offset_px: expected {"offset_px": [[row, col], ...]}'),
        ('{"offset_px": [[1, 2], [3]]}', "offset_px[1]: expected [float, float], got [3]"),
        ('{"offset_px": [1, 2]}', "offset_px[0]: expected [float, float], got 1"),
        ('{"offset_px": [[1, 2, 3]]}', "offset_px[0]: expected [float, float]"),
        ('{"offset_px": [["1", 2]]}', "offset_px[0][0]: expected float, got '1'"),
        ('{"offset_px": [[NaN, 2]]}', "offset_px: expected finite"),
        ('{"offset_px": [[null, {}]]}', "offset_px[0][0]: expected float"),
        ('{"offset_px": [[true, 2]]}', "offset_px[0][0]: expected float, got True"),
        ('{"offset_px": [[1, 2]], "offset_sigma_px": 3}', "offset_sigma_px: "),
        ('{"offset_px": [[1, 2]], "offset_source": "guess"}', "offset_source: "),
        ('{"offset_px": [[1, 2]], "offset_source": [1]}', "offset_source: "),
        ('{"offset_px": [[1, 2]], "sigma": 3}', "sigma: is not known, expected offset_px"),
        ("[" * 50_000, ""),
    ],
)
def test_bad_json_names_the_field(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(content)
    assert said in message_of_loading(path)


def test_bad_bytes_and_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"row,col\n\xff\xfe,1\n")
    message_of_loading(tmp_path / "a.csv")
    (tmp_path / "a.xls").write_text("row,col\n0,0\n")
    assert "expected shifts in a .csv or .json file" in message_of_loading(tmp_path / "a.xls")
    assert "no such file" in message_of_loading(tmp_path / "none.csv")
    assert "folder" in message_of_loading(tmp_path)


@given(
    content=st.binary(max_size=60) | st.text(alphabet='{}[]",:0123456789.row,col\n').map(str.encode)
)
@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_anything_else_is_a_data_error(suffix: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"any{suffix}"
    path.write_bytes(content)
    try:
        table = load_offsets(path)
    except DataError:
        message_of_loading(path)
    else:
        assert table.offset_px.ndim == 2
        assert np.isfinite(table.offset_px).all()


def message_of_loading(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        load_offsets(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message
