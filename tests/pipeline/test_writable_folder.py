"""Folders that cannot be made are refused before the work."""

import os
from pathlib import Path

import pytest

from lensshift.core.errors import DataError
from lensshift.pipeline.run import writable_folder


def test_a_folder_below_a_file_or_without_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert writable_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="this is a file: "):
        writable_folder(tmp_path / "file" / "b")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(DataError, match="no permission to write to"):
        writable_folder(tmp_path / "a" / "b")
