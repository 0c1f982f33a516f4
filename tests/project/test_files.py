"""Files: whatever has a name is written as it should be, and what comes from others is read within bounds."""

from __future__ import annotations

import gzip
import os
import platform
import stat
import threading
from pathlib import Path

import pytest

from driftplan import MapError, TrajectoryError, load_noise, load_world, load_zones, read_path
from driftplan.files import MAX_LINES, read_bytes, read_lines, write_files


def _read(descriptor, count):
    with open(descriptor, "rb") as file:
        return file.read(count)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_keeps_its_mode_and_a_new_one_has_the_usual(tmp_path):
    private, plain = tmp_path / "private", tmp_path / "plain"
    private.write_text("old")
    private.chmod(0o600)
    plain.write_text("usual")
    write_files({private: b"new", tmp_path / "added": b"new"})
    assert (private.read_bytes(), stat.S_IMODE(private.stat().st_mode)) == (b"new", 0o600)
    assert stat.S_IMODE((tmp_path / "added").stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
    assert names(tmp_path) == ["added", "plain", "private"]


def test_a_link_stays_a_link_and_its_file_is_written(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there/real").write_text("old")
    (tmp_path / "link").symlink_to("there/real")
    (tmp_path / "dangling").symlink_to("there/made")
    write_files({tmp_path / "link": b"new", tmp_path / "dangling": b"made"})
    assert (tmp_path / "link").is_symlink()
    assert ((tmp_path / "there/real").read_bytes(), (tmp_path / "there/made").read_bytes()) == (b"new", b"made")


def test_a_pipe_is_written_into_and_stays_one(tmp_path):
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="No such device"):  # nobody reads: to wait would be to hang
        write_files({pipe: b"lost", tmp_path / "other": b"x"})
    assert names(tmp_path) == ["pipe"]
    descriptor = os.open(pipe, os.O_RDWR)  # a reader that sees no end before the writer has come
    content = bytes(200_000)  # more than a pipe holds
    reader = threading.Thread(target=lambda: got.append(_read(descriptor, len(content))))
    reader.start()
    write_files({pipe: content})
    reader.join()
    assert got == [content]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes devices")
def test_a_device_is_written_into_and_stays_one(tmp_path):
    device = tmp_path / "null"
    try:
        os.mknod(device, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
        device.open("wb").close()
    except OSError:
        pytest.skip("no devices may be made here")
    write_files({device: b"gone"})
    assert stat.S_ISCHR(device.stat().st_mode)


def test_standard_output_by_its_path_is_not_replaced(tmp_path):
    import subprocess
    import sys

    code = "import pathlib, driftplan.files as f; f.write_files({pathlib.Path('/dev/stdout'): b'one\\n'}); print('two')"
    with (tmp_path / "out").open("wb") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert (tmp_path / "out").read_text() == "one\ntwo\n"


def test_two_names_of_one_file_are_refused_and_nothing_is_written(tmp_path):
    (tmp_path / "link").symlink_to("file")
    for other in (tmp_path / "link", tmp_path / "." / ".." / tmp_path.name / "file"):
        with pytest.raises(ValueError, match="a name of its own"):
            write_files({tmp_path / "file": b"1", other: b"2"})
    assert names(tmp_path) == ["link"]


def test_leftovers_of_the_dead_are_removed_and_those_of_the_living_kept(tmp_path):
    mine, dead = (f".driftplan-{platform.node()}-{process}-abc" for process in (os.getppid(), 2**22 + 1))
    for name in (mine, dead, ".driftplan-elsewhere-1-abc"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "half").write_text("written")
    write_files({tmp_path / "file": b"1"})
    assert names(tmp_path) == sorted([mine, ".driftplan-elsewhere-1-abc", "file"])


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    (tmp_path / "victim").write_text("precious")
    planted = iter(["taken", "taken", "free"])
    (tmp_path / f".driftplan-{platform.node()}-{os.getpid()}-taken").symlink_to("victim")
    monkeypatch.setattr("tempfile._get_candidate_names", lambda: planted)
    write_files({tmp_path / "file": b"new"})
    assert ((tmp_path / "victim").read_text(), (tmp_path / "file").read_bytes()) == ("precious", b"new")


def test_what_cannot_be_written_is_said_by_its_name(tmp_path):
    with pytest.raises(OSError, match=r"nowhere/a\.csv"):
        write_files({tmp_path / "b.csv": b"", tmp_path / "nowhere/a.csv": b""})
    assert names(tmp_path) == []


READERS = {
    ".yaml": lambda path: load_world(path, robot_radius=0.1),
    ".map": lambda path: load_world(path, robot_radius=0.1),
    ".geojson": lambda path: load_world(path, robot_radius=0.1),
    ".csv": read_path,
    ".csv.gz": read_path,
    ".yml": load_zones,
    ".noise": load_noise,
}


@pytest.mark.parametrize("suffix", READERS)
def test_pipes_devices_folders_and_what_is_missing_are_refused_at_once(tmp_path, suffix):
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    for name, said in (
        ("pipe", "regular file"),
        ("folder", "directory"),
        ("zero", "regular file"),
        ("gone", "No such"),
    ):
        with pytest.raises((MapError, TrajectoryError), match=said):
            READERS[suffix](tmp_path / f"{name}{suffix}")


def test_a_stream_that_was_asked_for_is_read(tmp_path):
    read, write = os.pipe()
    os.write(write, b"x,y\n0,0\n1,0\n")
    os.close(write)
    assert read_path(f"/dev/fd/{read}").tolist() == [[0, 0], [1, 0]]
    os.close(read)


def test_bytes_and_lines_are_bounded_also_unpacked(tmp_path):
    file, packed = tmp_path / "a.txt", tmp_path / "a.txt.gz"
    file.write_bytes(b"x" * 11)
    packed.write_bytes(gzip.compress(b"0" * 10_000))
    for path in (file, packed):
        with pytest.raises(TrajectoryError, match="at most 10 bytes"):
            read_bytes(path, TrajectoryError, max_bytes=10)
    packed.write_bytes(gzip.compress(b"\n" * (MAX_LINES + 1)))
    with pytest.raises(TrajectoryError, match="at most 2000000 lines"):
        read_path(packed)
    packed.write_bytes(gzip.compress(b"0,0\n1,0\n")[:-4])
    with pytest.raises(TrajectoryError, match="broken gzip"):
        read_path(packed)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_texts_of_any_editor_are_the_same_lines(tmp_path, encoding, end):
    Path(tmp_path, "a.csv").write_bytes(end.join(["x,y", "0,0", "2.5,0"]).encode(encoding))
    assert read_lines(tmp_path / "a.csv", TrajectoryError) == ["x,y", "0,0", "2.5,0"]
    assert read_path(tmp_path / "a.csv").tolist() == [[0, 0], [2.5, 0]]


@pytest.mark.parametrize("line", ["a" + " " * 400_000 + "b", "[" * 400_000, "a [" * 100_000, "a]" * 100_000])
def test_headers_take_time_by_their_length_only(tmp_path, line):
    (tmp_path / "a.csv").write_text(f"{line}\n1,2\n3,4\n")  # at the square of its length this would take an hour
    with pytest.raises(TrajectoryError, match=r"a\.csv"):
        read_path(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "text",
    ["a: &a [1, 1]\nb: *a\n", "heading_var_per_m: 1\nheading_var_per_m: 2\n", "[" * 900, f"step_m: {'9' * 400}"],
)
def test_yaml_is_plain(tmp_path, text):
    (tmp_path / "noise.yaml").write_text(text)
    with pytest.raises(TrajectoryError, match=r"noise\.yaml"):
        load_noise(tmp_path / "noise.yaml")
