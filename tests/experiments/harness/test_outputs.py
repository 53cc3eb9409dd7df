"""The output folder appears complete or not at all, and nothing of the user's is lost."""

import json
import os
import stat

import pytest
from refusals import refuses

from experiments.harness import outputs
from experiments.harness.outputs import PROGRAM, RECORD, OutputFolder
from optics.errors import ConfigError


def write(folder, name, text="x"):
    """Write a folder with one file and the record that makes it an output of ours."""
    with folder.writing() as staging:
        (staging / name).write_text(text)
        (staging / RECORD).write_text(json.dumps({"program": PROGRAM, "files": {name: "digest"}}))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_new_folder_with_its_parents_and_the_rights_of_any(tmp_path):
    folder = OutputFolder(tmp_path / "a" / "b")
    assert names(tmp_path) == []  # checking leaves nothing behind
    write(folder, "summary.json")
    assert names(tmp_path / "a") == ["b"]
    assert names(tmp_path / "a" / "b") == [RECORD, "summary.json"]
    (tmp_path / "empty").mkdir()
    rights = stat.S_IMODE((tmp_path / "empty").stat().st_mode)
    assert stat.S_IMODE((tmp_path / "a" / "b").stat().st_mode) == rights
    write(OutputFolder(tmp_path / "empty"), "a")
    assert names(tmp_path / "empty") == ["a", RECORD]


@pytest.mark.parametrize("exchange_works", [True, False])
def test_earlier_output_is_replaced(tmp_path, monkeypatch, exchange_works):
    if not exchange_works:
        monkeypatch.setattr(outputs, "_exchange", lambda first, second: False)
    out = tmp_path / "out"
    write(OutputFolder(out), "old")
    write(OutputFolder(out), "new")
    assert names(out) == ["new", RECORD]
    assert names(tmp_path) == ["out"]


def test_failed_second_rename_puts_the_earlier_output_back(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(OutputFolder(out), "old")
    monkeypatch.setattr(outputs, "_exchange", lambda first, second: False)
    rename = os.rename

    def failing(source, target):
        if ".partial-" in str(source):
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", failing)
    refuses(ConfigError, "Input/output error", write, OutputFolder(out), "new")
    monkeypatch.undo()
    assert names(out) == ["old", RECORD]
    assert names(tmp_path) == ["out"]


def test_an_earlier_output_that_cannot_be_put_back_is_kept_and_named(tmp_path, monkeypatch):
    write(OutputFolder(tmp_path / "out"), "old")
    monkeypatch.setattr(outputs, "_exchange", lambda first, second: False)
    rename, calls = os.rename, []

    def fails_from_the_second_on(source, target):
        calls.append(source)
        if len(calls) > 1:
            raise OSError(5, "Input/output error")
        rename(source, target)

    folder = OutputFolder(tmp_path / "out")
    monkeypatch.setattr(os, "rename", fails_from_the_second_on)
    message = refuses(ConfigError, "the earlier output is in", write, folder, "new")
    assert names(type(tmp_path)(message.rpartition(" is in ")[2])) == ["old", RECORD]


@pytest.mark.parametrize("earlier", [True, False])
@pytest.mark.parametrize("fault", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_interrupted_writing_leaves_everything_as_it_was(tmp_path, earlier, fault):
    out = tmp_path / "deep" / "out"
    if earlier:
        write(OutputFolder(out), "old")

    def half_way():
        with OutputFolder(out).writing() as staging:
            (staging / "half").write_text("x")
            raise fault

    refuses((KeyboardInterrupt, ConfigError), "^$|No space left on device", half_way)
    assert names(tmp_path) == (["deep"] if earlier else [])
    assert not earlier or (names(out), names(out.parent)) == (["old", RECORD], ["out"])


@pytest.mark.parametrize("name", ["notes.txt", RECORD])
@pytest.mark.parametrize(
    "record",
    [None, "{}", "not json", '["program"]', json.dumps({"program": "another", "files": {"notes.txt": ""}})],
)
def test_files_of_somebody_else_are_never_touched(tmp_path, record, name):
    out = tmp_path / "out"
    out.mkdir()
    if record is not None:
        (out / RECORD).write_text(record)
    (out / name).write_text("mine")
    refuses(ConfigError, "no earlier output; name another folder", OutputFolder, out)
    assert (out / name).read_text() == "mine"


def test_a_note_put_into_an_earlier_output_is_not_lost_before_or_during_the_run(tmp_path):
    out = tmp_path / "out"
    write(OutputFolder(out), "old")
    folder = OutputFolder(out)
    (out / "my-notes.txt").write_text("mine")
    refuses(ConfigError, r"my-notes\.txt", OutputFolder, out)
    refuses(ConfigError, r"my-notes\.txt", write, folder, "new")
    assert names(out) == ["my-notes.txt", "old", RECORD]
    assert names(tmp_path) == ["out"]


def test_folder_without_write_permission(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("the superuser may write everywhere")
    tmp_path.chmod(0o500)
    refuses(ConfigError, "Permission denied", OutputFolder, tmp_path / "out")


def test_link_to_a_folder_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(OutputFolder(tmp_path / "link"), "a")
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "real") == ["a", RECORD]
