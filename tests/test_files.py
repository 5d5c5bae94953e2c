"""Files are written aside and renamed."""

from pathlib import Path

import pytest

from climber.files import atomic_path, write_text


def test_finished_file_replaces_the_earlier_one_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    target = tmp_path / "plan.json"
    target.write_text("old")
    with atomic_path(target) as aside:
        aside.write_text("new")
        assert target.read_text() == "old"
        assert aside.suffix == ".json"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_failed_run_leaves_the_earlier_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "plan.json"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="halfway"), atomic_path(target) as aside:
        aside.write_text("ne")
        raise RuntimeError("halfway")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_missing_folders_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b" / "note.txt", "höld")
    assert (tmp_path / "a" / "b" / "note.txt").read_text(encoding="utf-8") == "höld"
