"""`record --drive`: a robot driven by keys, in a terminal and in a browser."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.cli.drive_terminal import half_blocks, keys_of, plan_lines
from maomaps_warp.errors import InputError
from maomaps_warp.io.sources import SourceOptions, open_source
from maomaps_warp.jobs.drive import DEBOUNCE_S, Drive
from maomaps_warp.jobs.record import Driving, RecordOptions
from maomaps_warp.model.camera import Camera

OPTIONS = RecordOptions(camera=Camera.from_fov(32, 24, 90.0), driving=Driving(rate_hz=10.0))
#: Seconds that a slow machine may take to start Warp and a scene.
PATIENCE_S = 120.0


class Clock:
    """Seconds that pass only when they are told to."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def a_drive(clock: Clock | None = None) -> Drive:
    return Drive("flat:1", OPTIONS, (32, 24), now=clock or Clock())


def press_record(drive: Drive) -> None:
    """As somebody does who takes their time."""
    drive._now.seconds += 2.0 * DEBOUNCE_S
    drive.toggle()


def test_a_run_is_what_was_driven_between_two_marks() -> None:
    drive = a_drive()
    drive.step()
    press_record(drive)
    for _ in range(10):
        drive.press("forward")
        glance = drive.step()
    assert glance.state == "recording" and glance.seconds == pytest.approx(0.9)
    press_record(drive)
    assert drive.state == "done"
    run = drive.trajectory
    assert len(run) == 10 and run.duration_s == pytest.approx(0.9)
    assert 0.2 < run.path_length < 0.5
    np.testing.assert_array_equal(run.T_world_camera[-1], glance.T_world_camera)


def test_what_is_shown_is_what_the_camera_sees_and_the_map_grows() -> None:
    drive = a_drive()
    sizes = []
    for _ in range(30):
        drive.press("left")
        glance = drive.step(with_map=True)
        if glance.map is not None:
            sizes.append(len(glance.map))
    assert glance.seen.colors is not None and glance.seen.colors.shape == (24, 32, 3)
    assert len(sizes) == 6 and sizes[-1] > 1.2 * sizes[0] > 100


def test_a_record_key_that_is_held_or_struck_twice_counts_once() -> None:
    drive = a_drive()
    drive.toggle()
    for _ in range(30):  # repeats of a key that is held, for much longer than one is not listened to
        drive._now.seconds += 0.5 * DEBOUNCE_S
        drive.toggle()
    assert drive.state == "recording"


def test_leaving_ends_a_run_and_never_throws_one_away() -> None:
    drive = a_drive()
    press_record(drive)
    drive.step()
    drive.leave()
    drive.leave()
    assert drive.state == "done"


def test_a_drive_that_was_left_has_no_run() -> None:
    drive = a_drive()
    drive.leave()
    assert drive.state == "left"
    with pytest.raises(InputError, match="nothing was recorded"):
        _ = drive.trajectory


def test_a_picture_is_two_pixels_a_character() -> None:
    colors = np.zeros((4, 3, 3), dtype=np.uint8)
    colors[0, 1] = (255, 0, 7)
    colors[3, 2] = (1, 2, 3)
    lines = half_blocks(colors)
    assert [line.count("▀") for line in lines] == [3, 3]
    assert lines[0].split("▀")[1] == "\x1b[38;2;255;0;7m\x1b[48;2;0;0;0m"
    assert lines[1].split("▀")[2] == "\x1b[38;2;0;0;0m\x1b[48;2;1;2;3m"


def test_the_plan_shows_where_the_robot_is_and_looks() -> None:
    drive = a_drive()
    drive.robot.yaw = np.pi / 2
    lines = plan_lines(drive, 40, 20)
    assert len(lines) == 20 and all(len(line) <= 40 for line in lines)
    assert "".join(lines).count("↑") == 1
    free = sum(line.count("·") for line in lines)
    assert free == pytest.approx(drive.space.is_free.mean() * sum(len(line) for line in lines), rel=0.15)


def test_keys_are_whole_escape_sequences_or_single_characters() -> None:
    assert keys_of("Wa \x1b[A\x1bOD\x1b[1;5Cq") == (["w", "a", " ", "\x1b[A", "\x1bOD", "\x1b[1;5C", "q"], "")
    assert keys_of("w\x1b[1;") == (["w"], "\x1b[1;")
    assert keys_of("\x1b[1;" + "5A") == (["\x1b[1;5A"], "")
    assert keys_of("\x1b") == ([], "\x1b")


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_while_driving_keeps_the_run(tmp_path: Path) -> None:
    import pty

    bag = tmp_path / "run.bag"
    command = [sys.executable, "-m", "maomaps_warp", "record", "flat:1", "-o", str(bag), "--drive", "terminal"]
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [*command, "--camera", "32x24@90", "--device", "cpu"], stdin=slave, stdout=slave, stderr=slave
    )
    os.close(slave)
    _read_until(master, "○ waiting", running)
    os.write(master, b"r")
    _read_until(master, r"● recording +([1-9]|\d\d+)\.\d s", running)
    os.kill(running.pid, signal.SIGINT)
    text = _read_until(master, "wrote", running)
    assert running.wait(PATIENCE_S) == 0, text
    os.close(master)
    assert bag.exists()


@pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal")
def test_driving_in_a_terminal_makes_a_bag(tmp_path: Path) -> None:
    import pty

    bag = tmp_path / "run.bag"
    command = [sys.executable, "-m", "maomaps_warp", "record", "flat:1", "-o", str(bag), "--drive", "terminal"]
    master, slave = pty.openpty()
    environment = os.environ | {"COLUMNS": "60", "LINES": "20"}
    running = subprocess.Popen(
        [*command, "--camera", "32x24@90", "--device", "cpu"], stdin=slave, stdout=slave, stderr=slave, env=environment
    )
    os.close(slave)
    _read_until(master, "○ waiting", running)
    os.write(master, b"r")
    _read_until(master, "● recording", running)
    # However slow the machine is: until it drives, and a second is over.
    _read_until(master, r"\+0\.[1-9]\d m/s", running, keys=b"w\x1b[D")
    _read_until(master, r"([1-9]|\d\d+)\.\d s", running, keys=b"w\x1b[D")
    os.write(master, b"r")
    text = _read_until(master, "wrote", running)
    assert running.wait(PATIENCE_S) == 0, text
    os.close(master)
    source = open_source(bag, SourceOptions(pose_frame="maomaps-c"), "gt")
    assert source.trajectory is not None and source.frames is not None
    assert len(list(source.frames.read(True))) == len(source.trajectory) > 10
    assert source.trajectory.path_length > 0.05
    yaw = np.arctan2(*source.trajectory.T_world_camera[[0, -1], 1::-1, 2].T)
    assert yaw[1] - yaw[0] > 0.05, "an arrow to the left turns left"


def _read_until(terminal: int, words: str, running: subprocess.Popen[bytes], keys: bytes = b"") -> str:
    """What the command shows, until it matches; `keys` are typed meanwhile. A command that hangs is killed."""
    text, end = "", time.monotonic() + PATIENCE_S
    while not re.search(words, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text[-4000:])):
        if time.monotonic() > end:
            running.kill()
            raise AssertionError(text[-2000:])
        if keys:
            os.write(terminal, keys)
        if not select.select([terminal], [], [], 0.1)[0]:
            continue
        try:
            text += os.read(terminal, 65536).decode("utf-8", "replace")
        except OSError:
            raise AssertionError(f"ended with {running.wait()}: {text[-2000:]}") from None
    return text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--drive", "terminal"), "needs a terminal"),
        (("--drive", "terminal", "--waypoint", "1,1"), "give one or the other"),
        (("--drive", "browser", "--trajectory", "t.txt"), "give one or the other"),
        (("--drive", "browser", "--start", "100,100"), "the nearest free place"),
        (("--drive", "browser", "--duration", "5"), "--drive browser: given beside --duration"),
        (("--drive", "browser", "--port", "99999"), "99999"),
    ],
)
def test_a_drive_that_cannot_begin_is_one_line(
    tmp_path: Path, options: tuple[str, ...], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is not refused would wait for somebody to drive.
    for where in ("browser", "terminal"):
        monkeypatch.setattr(f"maomaps_warp.cli.drive_{where}.drive_in_{where}", lambda drive, *_: drive.leave())
    done = CliRunner().invoke(app, ["record", "flat:1", "-o", str(tmp_path / "run.bag"), "--device", "cpu", *options])
    assert done.exit_code == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_page_shows_the_drive_and_obeys_its_buttons_and_keys() -> None:
    pytest.importorskip("viser")
    from maomaps_warp.cli.drive_browser import BrowserView

    drive = a_drive()
    view = BrowserView(drive, 0)
    try:
        assert re.fullmatch(r"http://localhost:\d+", view.address)
        glance = drive.step(with_map=True)
        view.show(glance)
        assert "waiting" in view.status.content and view.button.label == "Start recording (R)"
        np.testing.assert_allclose(view.robot.position, glance.T_world_camera[:3, 3], rtol=0, atol=1e-12)
        drive._now.seconds += 1.0
        view.commands["R"]()
        assert drive.state == "recording"
        for _ in range(10):
            view.commands["W"]()
            view.commands["arrowleft"]()
            glance = drive.step()
            view.show(glance)
        assert drive.robot.speed > 0.3 and drive.robot.yaw > 0.3
        assert "recording" in view.status.content and view.button.label == "Stop and save (R)"
        drive._now.seconds += 1.0
        view.commands["R"]()
        assert drive.state == "done" and drive.trajectory.path_length > 0.1
    finally:
        view.close()


def test_a_drive_is_kept_when_its_recording_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from maomaps_warp.io.trajectories import read_trajectory
    from maomaps_warp.jobs import record as record_job

    def drive_a_bit(drive: Drive) -> None:
        drive.toggle()
        for _ in range(12):
            drive.press("forward")
            drive.step()
        drive.leave()

    def fail(*_: object, **__: object) -> None:
        raise InputError("run.bag", "the disk is full")

    monkeypatch.setattr("maomaps_warp.cli.drive_terminal.picture_size", lambda aspect: (32, 24))
    monkeypatch.setattr("maomaps_warp.cli.drive_terminal.drive_in_terminal", drive_a_bit)
    monkeypatch.setattr(record_job, "record_world", fail)
    command = ["record", "flat:1", "-o", str(tmp_path / "run.bag"), "--drive", "terminal", "--device", "cpu"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 2 and "the disk is full" in done.stderr
    kept = re.search(r"kept   (.*drive\.txt): the whole drive, for --trajectory", done.stdout)
    assert kept is not None, done.output
    assert len(read_trajectory(Path(kept[1]))) == 12


def test_the_page_is_for_this_machine_alone_and_shows_what_the_robot_sees() -> None:
    pytest.importorskip("viser")
    from maomaps_warp.cli.drive_browser import BrowserView

    drive = a_drive()
    view = BrowserView(drive, 0)
    try:
        assert view.server.get_host() == "127.0.0.1"
        glance = drive.step(with_map=True)
        view.show(glance)
        np.testing.assert_array_equal(view.picture.image, glance.seen.colors)
        assert glance.map is not None
        assert set(view.commands) == {
            "W",
            "A",
            "S",
            "D",
            "R",
            "arrowup",
            "arrowdown",
            "arrowleft",
            "arrowright",
            "space",
        }
        view.commands["arrowdown"]()
        drive.step()
        assert drive.robot.speed < 0.0
    finally:
        view.close()
