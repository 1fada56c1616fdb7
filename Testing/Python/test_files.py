"""Files and folders are written completely or not at all."""

from __future__ import annotations

import errno
import os

import pytest

from VICRegistrationLib.files import keep_inputs, replacing, replacing_folder


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def write_file(path, content="new", error=None):
    with replacing(path) as draft:
        draft.write_text(content)
        if error is not None:
            raise error


def write_folder(folder, files="a", error=None):
    with replacing_folder(folder) as drafts:
        for name in files:
            (drafts / name).write_text("new")
        if error is not None:
            raise error


def test_a_file_appears_with_its_content(tmp_path):
    with replacing(tmp_path / "a.txt") as draft:
        draft.write_text("new")
        assert names(tmp_path) != ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, OSError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_file(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises((OSError, KeyboardInterrupt)):
        write_file(tmp_path / "a.txt", error=error)
    assert (tmp_path / "a.txt").read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_the_complaint_names_the_file_and_the_reason(tmp_path):
    with pytest.raises(OSError, match=r"b.a\.txt cannot be written \(No such file or directory\); choose a folder"):
        write_file(tmp_path / "b" / "a.txt")


def test_a_new_folder_appears_with_all_its_files(tmp_path):
    target = tmp_path / "one" / "two"
    with replacing_folder(target) as drafts:
        (drafts / "sub").mkdir()
        (drafts / "a").write_text("a")
        (drafts / "sub" / "b").write_text("b")
        assert not (tmp_path / "one").exists()
    assert names(target) == ["a", "sub", "sub/b"]
    assert names(tmp_path) == ["one", "one/two", "one/two/a", "one/two/sub", "one/two/sub/b"]


def test_other_files_of_a_folder_stay(tmp_path):
    (tmp_path / "a").write_text("old")
    (tmp_path / "other").write_text("other")
    with replacing_folder(tmp_path) as drafts:
        (drafts / "a").write_text("new")
        assert (tmp_path / "a").read_text() == "old"
    assert (tmp_path / "a").read_text() == "new"
    assert names(tmp_path) == ["a", "other"]


def test_what_is_outdated_goes_and_what_is_written_anew_stays(tmp_path):
    for name in "ab":
        (tmp_path / name).write_text("old")
    with replacing_folder(tmp_path, outdated=["a", "b", "c"]) as drafts:
        (drafts / "a").write_text("new")
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "new"


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt])
def test_a_failure_leaves_the_folder_as_it_was(tmp_path, error):
    with pytest.raises(error):
        write_folder(tmp_path / "out", error=error)
    assert names(tmp_path) == []


def test_files_that_were_moved_are_moved_back(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("old")
    replace = os.replace

    def full_for_b(source, target):
        if os.path.basename(target) == "b" and os.path.dirname(target) == str(tmp_path):
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full_for_b)
    with pytest.raises(OSError, match="No space left on device"):
        write_folder(tmp_path, "ab")
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_a_folder_in_the_way_of_a_file_is_refused(tmp_path):
    (tmp_path / "b").mkdir()
    with pytest.raises(OSError, match="b is a folder there"):
        write_folder(tmp_path, "ab")
    assert names(tmp_path) == ["b"]


@pytest.mark.parametrize("inside", ["file", "file/folder"])
def test_a_file_in_the_place_of_the_folder_is_refused_before_any_work(tmp_path, inside):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file is not a folder; choose a folder"), replacing_folder(tmp_path / inside):
        pytest.fail("the work must not begin")


def test_the_complaint_about_a_draft_names_the_file_asked_for(tmp_path):
    def write():
        with replacing_folder(tmp_path / "out") as drafts:
            (drafts / "a").mkdir()
            write_file(drafts / "a")

    with pytest.raises(OSError, match="cannot be written") as caught:
        write()
    assert str(tmp_path / "out" / "a") in str(caught.value)
    assert ".vic-" not in str(caught.value)


def test_a_result_may_not_replace_what_is_read(tmp_path):
    (tmp_path / "input").write_text("")
    (tmp_path / "link").symlink_to("input")
    keep_inputs([tmp_path / "result"], [tmp_path / "input"])
    with pytest.raises(ValueError, match="link would replace .*input, which is read; choose another"):
        keep_inputs([tmp_path / "link"], [tmp_path / "input"])
