# SPDX-License-Identifier: Apache-2.0
"""A session on disk survives kills, a full disk and damaged files."""

import hashlib
import json
import logging
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from conftest import python_path
from disk_flushes import record_flushes
from toss_task import ANY_ARM, CANDIDATES, next_trial, practice_in, practice_of, toss

from wam_power_ros import durable_files
from wam_power_ros.learning.policy import Policy, from_json, to_json
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session import ACKNOWLEDGED, Session, read
from wam_power_ros.practice.settings import preset

SETTINGS = preset("flip", budget=24, retests=3)
HERE = Path(__file__).resolve().parents[1]


def begun(folder: Path, rollouts: int = 0, seed: int = 5) -> Path:
    """Folder of a closed session of some rollouts."""
    with Session.begin(
        folder, SETTINGS, seed, CANDIDATES, context={"home": [0.0, 20.0]}
    ) as session:
        go_on(session, session.practice(ANY_ARM), rollouts)
    return folder


def go_on(session: Session, practice: Practice, rollouts: int) -> None:
    for _ in range(rollouts):
        trial = practice.next_trial()
        if trial is None:
            return
        session.append(
            practice.learn_assessed(trial, toss(trial, practice.task.settings), clock={"pid": 1})
        )


def acknowledge(folder: Path, log: bytes) -> None:
    """Write acknowledged.json as if this log was acknowledged last."""
    noted = {
        "rollouts": log.count(b"\n"),
        "bytes": len(log),
        "sha256": hashlib.sha256(log).hexdigest(),
    }
    (folder / ACKNOWLEDGED).write_text(json.dumps(noted))


def test_a_session_opens_as_it_was_closed(tmp_path: Path) -> None:
    folder = begun(tmp_path / "deep" / "s", 7)
    with Session.open(folder) as session:
        assert session.header.settings == SETTINGS and session.header.seed == 5
        assert session.context == {"home": [0.0, 20.0]}
        assert session.header.versions["python"] == sys.version.split()[0]
        assert [to_json(policy) for policy in session.candidates] == list(map(to_json, CANDIDATES))
        assert [record.number for record in session.records] == list(range(1, 8))
        assert (folder / "bags").is_dir()
        found = read(folder)
        assert found.header == session.header and found.records == session.records
        assert list(map(to_json, found.candidates)) == list(map(to_json, CANDIDATES))
        assert next_trial(practice_in(folder)) == next_trial(session.practice(ANY_ARM))


@pytest.mark.requirement("S-62")
def test_killed_at_any_boundary_or_within_a_line_it_goes_on_bit_identically(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    practice = practice_of(CANDIDATES, SETTINGS, 5)  # undisturbed
    expected = [next_trial(practice)]
    while (trial := practice.next_trial()) is not None:
        practice.learn_assessed(trial, toss(trial, SETTINGS.task_settings))
        expected.append(next_trial(practice))
    folder = begun(tmp_path / "s", 99)
    log = folder / "rollouts.jsonl"
    lines = log.read_bytes().splitlines(keepends=True)
    assert len(lines) == len(expected) - 1 >= 24
    rng = random.Random(0)
    for cut in range(len(lines) + 1):
        whole = b"".join(lines[:cut])
        torn = lines[cut] if cut < len(lines) else b'{"schema"\n'
        for length in (0, rng.choice((1, rng.randrange(1, len(torn)), len(torn) - 1))):
            caplog.clear()
            log.write_bytes(whole + torn[:length])
            acknowledge(folder, b"".join(lines[: rng.choice((cut, max(0, cut - 1)))]))
            assert len(read(folder).records) == cut  # looking does not touch
            assert log.read_bytes() == whole + torn[:length]
            with Session.open(folder) as session:
                assert len(session.records) == cut
                if length and cut % 5 == 2:
                    assert next_trial(session.practice(ANY_ARM)) == expected[cut]
            assert log.read_bytes() == whole
            warned = [r for r in caplog.records if r.levelno == logging.WARNING]
            assert len(warned) == (length > 0)
            assert all(f"cut off {length} bytes after line {cut}" in r.message for r in warned)


WRITER = """
import sys
from wam_power_ros.practice.session import Session
from toss_task import ANY_ARM, practice_in, practice_of, toss

with Session.open(sys.argv[1]) as session:
    practice = session.practice(ANY_ARM)
    while (trial := practice.next_trial()) is not None:
        session.append(practice.learn_assessed(trial, toss(trial, practice.task.settings)))
        print(trial.number, flush=True)  # acknowledged
        session.save_policy(practice.best.policy)
"""


@pytest.mark.requirement("S-61")
def test_kill_9_loses_no_acknowledged_rollout(tmp_path: Path) -> None:
    settings = preset("flip", budget=3000, confirm=0)
    folder = tmp_path / "s"
    Session.begin(folder, settings, 0, CANDIDATES).close()
    environment = os.environ | {"PYTHONPATH": python_path(HERE.parent, HERE)}
    rng = random.Random(1)
    acknowledged = 0
    for _ in range(2):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        first = writer.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.15))
        writer.send_signal(signal.SIGKILL)
        # not by communicate(): it would pass over what readline() has read ahead
        rest, errors = writer.stdout.read(), writer.stderr.read()
        writer.wait(10.0)
        writer.stdout.close()
        writer.stderr.close()
        numbers = [int(line) for line in [first, *rest.split("\n")] if line.strip()]
        assert numbers == list(range(numbers[0], numbers[-1] + 1)), errors
        # At most the one that was on disk but not yet printed lies between two lives.
        assert acknowledged + 1 <= numbers[0] <= acknowledged + 2
        acknowledged = numbers[-1]
        records = read(folder).records
        assert acknowledged <= len(records) <= acknowledged + 1
        if (folder / "policy.json").exists():
            from_json((folder / "policy.json").read_text())  # whole, whenever it was
    practice = practice_of(CANDIDATES, settings, 0)
    for record in read(folder).records:
        trial = practice.next_trial()
        assert practice.learn_assessed(trial, toss(trial, settings.task_settings)) == record


@pytest.mark.requirement("S-61")
def test_a_rollout_is_flushed_as_a_whole_before_it_is_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s", 2)
    log = folder / "rollouts.jsonl"
    with Session.open(folder) as session:
        flushed = record_flushes(monkeypatch, log.read_bytes)
        go_on(session, session.practice(ANY_ARM), 1)
        assert flushed[0] == (log, log.read_bytes())
        assert [path for path, _ in flushed[1:]] == [folder / f".{ACKNOWLEDGED}.part", folder]
    assert len(read(folder).records) == 3


@pytest.mark.requirement("S-61")
def test_a_session_is_flushed_with_all_it_needs_before_its_header_makes_it_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "new" / "deep" / "s"
    flushed = record_flushes(monkeypatch, lambda: Session.exists(folder))
    Session.begin(folder, SETTINGS, 5, CANDIDATES).close()
    before = [path for path, is_session in flushed if not is_session]
    after = [path for path, is_session in flushed if is_session]
    candidates = folder / "candidates"
    assert before == [
        candidates / ".flick-1.json.part",
        candidates,
        candidates / ".flick-2.json.part",
        candidates,
        folder / ".task.json.part",
        folder,
        folder / ".session.yaml.part",
    ]
    parents = [folder.parent, folder.parent.parent, tmp_path]  # of folders that are new
    assert after == [folder, *parents, folder / "rollouts.jsonl", folder]


@pytest.mark.requirement("S-61")
def test_a_torn_line_is_cut_off_on_the_disk_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s", 2)
    log = folder / "rollouts.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole + b'{"schema"')
    flushed = record_flushes(monkeypatch, log.read_bytes)
    Session.open(folder).close()
    assert flushed == [(log, whole), (folder, whole)]


@pytest.mark.requirement("S-63")
def test_only_one_learner_writes_a_session_and_none_begins_another_over_it(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 1)
    with Session.open(folder) as session:
        with pytest.raises(ValueError, match="being written by another learner"):
            Session.open(folder)
        with pytest.raises(ValueError, match="being written by another learner"):
            Session.begin(folder, SETTINGS, 0, CANDIDATES)
        go_on(session, session.practice(ANY_ARM), 1)
    with pytest.raises(ValueError, match="holds a session already"):
        Session.begin(folder, SETTINGS, 0, CANDIDATES)
    assert len(read(folder).records) == 2
    for look in (Session.open, read):
        with pytest.raises(ValueError, match=r"no session\.yaml"):
            look(tmp_path)


def test_a_log_that_may_not_grow_is_left_as_it_was(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 3)
    log = folder / "rollouts.jsonl"
    before = log.read_bytes()
    with Session.open(folder) as session:
        practice = session.practice(ANY_ARM)
        trial = practice.next_trial()
        record = practice.learn_assessed(trial, toss(trial, SETTINGS.task_settings))
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 100, limits[1]))
        try:
            with pytest.raises(OSError, match="File too large"):
                session.append(record)  # 100 bytes of it are written, then no more
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert log.read_bytes() == before
        session.append(record)
        with pytest.raises(ValueError, match="rollout 4 cannot follow rollout 4"):
            session.append(record)
    assert len(read(folder).records) == 4
    with pytest.raises(ValueError, match="closed"):
        session.append(record)


def test_a_malformed_line_is_named_and_nothing_is_changed(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 4)
    log = folder / "rollouts.jsonl"
    lines = log.read_bytes().splitlines(keepends=True)
    record = json.loads(lines[1])
    for damaged, reason in [
        (b"{broken\n", "line 2: the line is not JSON"),
        (b"\xff\xfe\n", "line 2: 'utf-8' codec"),
        (json.dumps({**record, "schema": "x/2"}).encode() + b"\n", "line 2: schema = 'x/2': "),
        (lines[0], "line 2: rollout 1 cannot follow rollout 1"),
    ]:
        text = b"".join([lines[0], damaged, *lines[2:]])
        log.write_bytes(text)
        for look in (Session.open, read):
            with pytest.raises(ValueError, match=rf"rollouts\.jsonl, {reason}"):
                look(folder)
        assert log.read_bytes() == text
    changed = json.dumps({**record, "z": [1.0] * len(record["z"])}).encode() + b"\n"
    text = b"".join([lines[0], changed, *lines[2:]])
    log.write_bytes(text)
    acknowledge(folder, text)  # changed before it was written
    with Session.open(folder) as session, pytest.raises(ValueError, match="record 2: z is not"):
        session.practice(ANY_ARM)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"schema": "wam_power_ros/session/9"}, "schema = 'wam_power_ros/session/9': "),
        ({"settings": {"task": "fly", "learner": "power"}}, "settings: .*task 'fly' is not one of"),
    ],
)
def test_a_malformed_header_is_named(tmp_path: Path, change: dict, reason: str) -> None:
    folder = begun(tmp_path / "s", 1)
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
    with pytest.raises(ValueError, match=rf"session\.yaml: {reason}"):
        Session.open(folder)
    Session.begin(tmp_path / "other", SETTINGS, 0, CANDIDATES).close()  # no lock is left behind


@pytest.mark.requirement("S-17")
def test_headers_that_would_run_code_and_candidates_that_differ_are_refused(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 1)
    path = folder / "session.yaml"
    text = path.read_text()
    for damage in ("!!python/object/apply:os.getcwd []", "a: [", "5", "a: &a [1]\nb: [*a, *a]"):
        path.write_text(damage)
        with pytest.raises(ValueError) as refused:
            Session.open(folder)
        assert str(refused.value).count("session.yaml") == 1
    path.write_text(text.replace("flick-2", "../../x"))
    with pytest.raises(ValueError, match=r"session\.yaml: candidates = .* must match"):
        Session.open(folder)
    path.write_text(text)
    candidate = folder / "candidates" / "flick-2.json"
    candidate.write_text(to_json(CANDIDATES[0]))
    with pytest.raises(ValueError, match=r"flick-2\.json: holds policy 'flick-1'"):
        Session.open(folder)
    candidate.unlink()
    with pytest.raises(ValueError, match=r"flick-2\.json: .*No such file"):
        Session.open(folder)


@pytest.mark.requirement("S-64")
def test_a_reader_sees_the_old_policy_or_the_new_one(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s")
    with Session.open(folder) as session:
        for policy in CANDIDATES:
            session.save_policy(policy)
            saved: Policy = from_json((folder / "policy.json").read_text())
            assert to_json(saved) == to_json(policy)
    assert sorted(path.name for path in folder.iterdir()) == [
        ".lock", "bags", "candidates", "policy.json", "rollouts.jsonl", "session.yaml", "task.json"
    ]  # fmt: skip


@pytest.mark.requirement("S-69")
@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda log: log.unlink(), "is missing"),
        (lambda log: log.write_bytes(bytes(log.stat().st_size)), "has other contents"),
        (
            lambda log: log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:-1])),
            "has [0-9]+ bytes",
        ),
        (
            lambda log: log.write_text(log.read_text().replace("[346.9", "[346.8")),
            "has other contents",
        ),
    ],
)
def test_a_log_that_lost_what_was_acknowledged_is_an_error_and_never_begun_again(
    tmp_path: Path, damage: Callable[[Path], object], why: str
) -> None:
    folder = begun(tmp_path / "s", 6)
    log = folder / "rollouts.jsonl"
    whole = log.read_bytes()
    damage(log)
    there = log.read_bytes() if log.exists() else None
    assert there != whole
    for look in (Session.open, read):
        with pytest.raises(ValueError, match=rf"rollouts\.jsonl {why}.* 6 rollouts in "):
            look(folder)
    assert (log.read_bytes() if log.exists() else None) == there  # nothing was changed
    log.write_bytes(whole)
    with Session.open(folder) as session:
        assert len(session.records) == 6


@pytest.mark.requirement("S-69")
@pytest.mark.parametrize("damage", [Path.unlink, lambda log: log.write_bytes(bytes(5000))])
def test_a_session_of_before_the_acknowledgements_is_known_by_its_policy_to_have_lost_its_log(
    tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    folder = begun(tmp_path / "s", 6)
    with Session.open(folder) as session:
        session.save_policy(CANDIDATES[0])
    (folder / ACKNOWLEDGED).unlink()
    Session.open(folder).close()  # an old session: it goes on, and is acknowledged from now on
    assert json.loads((folder / ACKNOWLEDGED).read_text())["rollouts"] == 6
    (folder / ACKNOWLEDGED).unlink()
    damage(folder / "rollouts.jsonl")
    with pytest.raises(ValueError, match=r"rollouts\.jsonl has no rollout, but .*policy\.json"):
        Session.open(folder)


@pytest.mark.requirement("S-69")
@pytest.mark.parametrize(
    "name", ["rollouts.jsonl", "task.json", ACKNOWLEDGED, "candidates/flick-1.json"]
)
def test_a_fifo_in_place_of_a_file_of_a_session_is_refused_at_once(
    tmp_path: Path, name: str
) -> None:
    folder = begun(tmp_path / "s", 2)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(ValueError, match=f"{name} is a FIFO"):
        Session.open(folder)


@pytest.mark.requirement("S-69")
def test_other_versions_are_a_warning_that_names_both_and_are_recorded_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = begun(tmp_path / "s", 2)
    Session.open(folder).close()
    assert not caplog.records  # the same versions
    path = folder / "session.yaml"
    header = yaml.safe_load(path.read_text())
    header["versions"] |= {"numpy": "0.9.6", "abacus": "1"}
    path.write_text(yaml.safe_dump(header))
    now = version("numpy")
    for _ in range(2):
        caplog.clear()
        with Session.open(folder) as session:
            assert len(session.header.resumed) == 1
            assert session.header.resumed[0]["numpy"] == now
            assert session.header.versions["numpy"] == "0.9.6"
        (warned,) = caplog.records
        assert f"abacus 1, now none; numpy 0.9.6, now {now}" in warned.message
    assert read(folder).header.resumed == session.header.resumed


def test_a_disk_that_refuses_the_acknowledgement_costs_no_rollout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    folder = begun(tmp_path / "s", 2)
    with Session.open(folder) as session, monkeypatch.context() as patch:

        def refuse(*_: object) -> None:
            raise OSError(28, "No space left on device")

        patch.setattr(durable_files, "replace", refuse)
        go_on(session, session.practice(ANY_ARM), 2)
    said = "acknowledged.json: No space left on device; free some space on its disk"
    assert "could not be written" in caplog.text and said in caplog.text
    with Session.open(folder) as session:
        assert len(session.records) == 4
