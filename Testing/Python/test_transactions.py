"""A change of a folder happens completely or not at all, wherever the process is killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

import VICRegistrationLib
from VICRegistrationLib import transactions
from VICRegistrationLib.files import replacing_folder
from VICRegistrationLib.transactions import DRAFTS, commit, one_at_a_time, recover, roll_back, work_folder

OLD = {"a": "old", "b": "old", "gone": "old", "mine": "mine", "sub/d": "old"}
NEW = {"a": "new", "c": "new", "mine": "mine", "b": "old", "sub/d": "new", "sub/deep/e": "new"}
WRITTEN = {"a", "c", "sub/d", "sub/deep/e"}

# Forks, and kills itself at one event after the other: opening, linking, moving, removing files and folders.
KILLED_EVERYWHERE = """
import json, os, sys
from VICRegistrationLib.files import replacing_folder
from VICRegistrationLib.transactions import recover

def fill(folder, files):
    for name, text in files.items():
        path = os.path.join(folder, name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "w") as file:
            file.write(text)

def content(folder):
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(place, name)
            with open(path) as file:
                found[os.path.relpath(path, folder)] = file.read()
    return found

left = None

def hook(event, arguments):
    global left
    if left is None or event not in ("open", "os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir"):
        return
    left -= 1
    if left == 0:
        os._exit(9)

def change(folder, events, files):
    global left
    left = events
    with replacing_folder(folder, outdated=["gone"]) as drafts:
        fill(drafts, files)
    left = None

def recovered(folder, events):
    global left
    left = events
    recover(folder)
    left = None

def run(call, *arguments):
    child = os.fork()
    if child == 0:
        call(*arguments)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

# What the system holds in memory outlives a process.
os.fsync = lambda number: None
sys.addaudithook(hook)
base, old, new = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
outcomes, events = [], 0
while True:
    events += 1
    folder = os.path.join(base, str(events), "folder")
    os.mkdir(os.path.dirname(folder))
    if old is not None:
        fill(folder, old)
    code = run(change, folder, events, new)
    first = content(folder)
    # Recovering may be killed too.
    if code:
        run(recovered, folder, 1 + events % 25)
        recover(folder)
    outcomes.append([code, first, content(folder)])
    if code == 0:
        break
print(json.dumps(outcomes))
"""


@pytest.fixture
def old(tmp_path):
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    for name, text in OLD.items():
        (folder / name).write_text(text)
    return folder


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def change(folder, error=None):
    """Replace a file and remove one, unless a move fails: the last one does."""
    replace = os.replace

    def failing(source, target):
        if error is not None and Path(target) == folder / "b" and DRAFTS in Path(source).parts:
            raise error
        replace(source, target)

    with pytest.MonkeyPatch.context() as patch, replacing_folder(folder, outdated=["gone"]) as drafts:
        patch.setattr(os, "replace", failing)
        (drafts / "a").write_text("new")
        (drafts / "b").write_text("old")


def killed_everywhere(folder, old, new):
    """Exit code, files then, and files after recovery, for a kill at every event."""
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(KILLED_EVERYWHERE), str(folder), json.dumps(old), json.dumps(new)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(VICRegistrationLib.__file__).parents[1],
    )
    return json.loads(run.stdout)


def without_work(found):
    return {name: text for name, text in found.items() if not name.startswith(".vic-")}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no fork")
def test_a_kill_at_any_moment_leaves_all_old_files_or_all_new_ones(tmp_path):
    new = {name: "new" for name in WRITTEN}
    *killed, done = killed_everywhere(tmp_path, OLD, new)
    assert done == [0, NEW, NEW]
    assert len(killed) > 40
    assert {code for code, *_ in killed} == {9}
    ends = [end for _, _, end in killed]
    assert all(end in (OLD, NEW) for end in ends)
    # Both happen, and moves that had begun were undone; a file that both have never lacks.
    assert ends.count(OLD) > 20
    assert ends.count(NEW) > 2
    mixed = [without_work(first) for _, first, _ in killed if without_work(first) not in (OLD, NEW)]
    assert len(mixed) > 3
    assert all(set(OLD) - {"gone"} <= set(first) for _, first, _ in killed)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no fork")
def test_a_new_folder_is_there_with_everything_or_not_at_all(tmp_path):
    *killed, done = killed_everywhere(tmp_path, None, {"a": "new", "sub/b": "new"})
    assert done[1] == {"a": "new", "sub/b": "new"}
    assert len(killed) > 10
    assert all(first in ({}, done[1]) for _, first, _ in killed)


def test_what_a_journal_needs_is_on_the_disk_before_it_and_that_before_the_first_file_is_moved(old, monkeypatch):
    """When the power fails, what is not on the disk is lost: a kill of the process does not show that."""
    done, replace = [], os.replace

    def recording(source, target):
        done.append(f"{Path(target).name} moved")
        replace(source, target)

    monkeypatch.setattr(transactions, "to_disk", lambda path: done.append(path.name))
    monkeypatch.setattr(os, "replace", recording)
    with work_folder(old) as work:
        for name in ("a", "c"):
            (work / DRAFTS / name).write_text("new")
        commit(work, outdated=["gone"])
    journal = done.index("journal.json moved")
    # The drafts, and under a second name the old files.
    assert {"a", "c", "gone", "backups", "journal.json.draft"} <= set(done[:journal])
    assert done[journal + 1] == work.name
    assert done[journal + 2 : journal + 4] == ["a moved", "c moved"]
    assert old.name in done[journal + 4 :]


def test_files_that_are_replaced_never_lack(old, monkeypatch):
    seen = []
    replace = os.replace

    def watched(source, target):
        seen.append((old / "a").exists())
        replace(source, target)

    monkeypatch.setattr(os, "replace", watched)
    with replacing_folder(old) as drafts:
        (drafts / "a").write_text("new")
    assert seen
    assert all(seen)


def test_what_a_living_process_works_on_is_left_alone(old):
    with work_folder(old) as work:
        (work / DRAFTS / "a").write_text("new")
        recover(old)
        assert (work / DRAFTS / "a").read_text() == "new"
        commit(work, outdated=["gone"])
    assert content(old) == {name: "new" if name == "a" else text for name, text in OLD.items() if name != "gone"}


def test_rolling_back_twice_is_as_good_as_once(old):
    with work_folder(old) as work:
        (work / DRAFTS / "a").write_text("new")
        roll_back(work)
        roll_back(work)
    assert content(old) == OLD


def test_a_file_system_without_links_gets_copies(old, monkeypatch):
    def no_links(*arguments, **options):
        raise PermissionError

    monkeypatch.setattr(os, "link", no_links)
    with pytest.raises(ValueError, match="too late"):
        change(old, error=ValueError("too late"))
    assert content(old) == OLD
    change(old)
    assert content(old) == {name: "new" if name == "a" else text for name, text in OLD.items() if name != "gone"}


def test_a_link_that_is_replaced_leaves_what_it_leads_to(old, tmp_path):
    (tmp_path / "elsewhere").write_text("mine")
    (old / "a").unlink()
    (old / "a").symlink_to(tmp_path / "elsewhere")
    with replacing_folder(old) as drafts:
        (drafts / "a").write_text("new")
    assert (old / "a").read_text() == "new"
    assert (tmp_path / "elsewhere").read_text() == "mine"


def test_a_folder_that_somebody_else_makes_in_the_meantime_keeps_both(tmp_path):
    with replacing_folder(tmp_path / "out") as drafts:
        (drafts / "a").write_text("new")
        with replacing_folder(tmp_path / "out" / "sub") as others:
            (others / "b").write_text("new")
    assert content(tmp_path) == {"out/a": "new", "out/sub/b": "new"}


def test_one_process_at_a_time_and_nothing_stays_behind(tmp_path):
    folder = tmp_path / "new" / "folder"
    inside, told, most = [], [], []

    def work(number):
        with one_at_a_time(folder, on_wait=lambda: told.append(number)):
            inside.append(number)
            most.append(len(inside))
            (folder / str(number)).write_text("")
            time.sleep(0.02)
            inside.remove(number)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1, 1]
    assert told
    assert sorted(content(folder)) == ["0", "1", "2", "3"]


def test_a_folder_made_for_nothing_goes_again(tmp_path):
    with one_at_a_time(tmp_path / "new" / "folder"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_dead_process_goes_and_that_of_a_living_one_stays(tmp_path):
    (tmp_path / ".vic-lock").write_text("")
    recover(tmp_path)
    assert list(tmp_path.iterdir()) == []
    with one_at_a_time(tmp_path):
        recover(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [".vic-lock"]
    assert list(tmp_path.iterdir()) == []
