"""Saved states that are broken, edited or made to harm, and names of no files: refused, nothing lost."""

import os
import re
import resource
import signal
import socket
import stat
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import Flag, FootCalibrator, OnlineSetup, Parameters, Reference, replay
from surefoot.files import atomic_path, read_arrays, write_text

METHODS = ("moment", "window", "tare", "none")
SAMPLES = 150
FRESH = "Calibrate again, or load an older file."


@pytest.fixture(scope="module")
def log():
    return walk(0, 0.1, 3.0, 1.0, Faults.bad())


@pytest.fixture(scope="module")
def row(log):
    return lambda k: Reference(*(part[k] for part in log.reference))


@pytest.fixture(scope="module")
def saved(log, row, tmp_path_factory):
    """Give the entries of a saved state, by method."""
    found = {}
    for method in METHODS:
        calibrator = make(method)
        for k in range(SAMPLES):
            calibrator.update(log.raw[k], row(k))
        path = tmp_path_factory.mktemp("saved") / "feet.npz"
        calibrator.save(path)
        found[method] = dict(np.load(path))
    return found


def make(method="moment", **options):
    return FootCalibrator(LAYOUT, method, **{"mass": MASS, "initial": NOMINAL} | options)


def change(saved, path, leaf, value, at=...):
    entries = dict(saved)
    entries[f"state.{leaf}"] = entries[f"state.{leaf}"].copy()
    entries[f"state.{leaf}"][at] = value
    np.savez(path, **entries)
    return path


@pytest.mark.parametrize("method", METHODS)
def test_no_number_that_is_impossible_is_loaded_and_what_was_learnt_stays(method, saved, log, row, tmp_path):
    calibrator, untouched = make(method), make(method)
    for one in (calibrator, untouched):
        one.update(log.raw[0], row(0))
    tried = 0
    for name, entry in saved[method].items():
        leaf = name.removeprefix("state.")
        if leaf == name or entry.dtype.kind not in "fi":
            continue
        wrong = (np.nan, 1e30) if entry.dtype.kind == "f" else (2**60, -(2**60))
        # In turn everywhere, and at one place alone.
        value, at = list(zip(wrong, (..., (0,) * entry.ndim), strict=True))[tried % 2]
        with pytest.raises(ValueError, match=rf"feet\.npz' cannot be loaded: '{leaf}' is "):
            calibrator.load(change(saved[method], tmp_path / "feet.npz", leaf, value, at))
        tried += 1
    assert tried >= 3
    for a, b in zip(calibrator.update(log.raw[1], row(1)), untouched.update(log.raw[1], row(1)), strict=True):
        np.testing.assert_array_equal(a, b)


ONE_SIDED = {
    "not symmetric": ("covariance", 0.5, (0, 1), "'covariance' is not symmetric, as a covariance is."),
    "negative variance": ("covariance", -0.5, (2, 2), "'covariance' has the negative eigenvalue -0.5"),
    "unknown flag": ("status", 131072, ..., "'status' is 1.311e+05, outside 0 to 1.311e+05."),
    "negative flag": ("status", -1, ..., "'status' is -1, outside 0 to 1.311e+05."),
    "a fault unheard of": (
        "faults.kind",
        262144,
        3,
        "'faults.kind' is 2.621e+05 at (3,), outside 0 to 1.311e+05",
    ),
    "100 body weights": ("belief.mean", 100.0, (0, 9), "'belief.mean' is 100 at (0, 9), outside -20 to 20"),
    "nothing to go back to": ("kept.belief.mean", np.nan, (0, 1), "'kept.belief.mean' is nan at (0, 1)"),
    "no motion": ("front.motion", 1e7, 5, "'front.motion' is 1e+07 at (5,), outside -1e+06 to 1e+06."),
    "no count": ("front.raw", 2.0**31, 0, "'front.raw' is 2.147e+09 at (0,), outside "),
}


@pytest.mark.parametrize(("leaf", "value", "at", "message"), ONE_SIDED.values(), ids=ONE_SIDED)
def test_what_no_filter_can_hold_is_named(leaf, value, at, message, saved, tmp_path):
    path = change(saved["moment"], tmp_path / "feet.npz", leaf, value, at)
    with pytest.raises(ValueError, match=re.escape(message)):
        make().load(path)


def test_limits_of_methods_are_their_own(saved, tmp_path):
    for method, leaf, value in (("window", "theta", 5.0), ("tare", "offset", 30.0)):
        path = change(saved[method], tmp_path / "feet.npz", leaf, value)
        with pytest.raises(
            ValueError, match=rf"'{leaf}' is {value:g} at \(0,\), outside .*{re.escape(FRESH)}"
        ):
            make(method).load(path)


def test_a_state_that_diverged_replaces_no_good_file(log, row, tmp_path):
    calibrator = make()
    calibrator.update(log.raw[0], row(0))
    calibrator.save(tmp_path / "feet.npz")
    before = (tmp_path / "feet.npz").read_bytes()
    state = calibrator.state
    calibrator.state = state._replace(
        belief=state.belief._replace(mean=np.full_like(state.belief.mean, np.nan))
    )
    with pytest.raises(ValueError, match=r"^Nothing was written to '.*': 'belief.mean' is nan"):
        calibrator.save(tmp_path / "feet.npz")
    assert (tmp_path / "feet.npz").read_bytes() == before


def bomb(path):
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("state.mean.npy", "w") as file,
    ):
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (2**22,)}
        )
        for _ in range(32):
            file.write(bytes(2**20))


def lie(path, shape=(10**12,), descr="<f8"):
    with zipfile.ZipFile(path, "w") as archive, archive.open("state.mean.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
        file.write(bytes(64))


def numbers():
    file = BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


def twice(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("format.npy", numbers())
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("format.npy", numbers())


def no_zip_in_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("state.mean.npy", b"\x93NUMPY\x09\x00 no such version")


ARCHIVES = {
    "a bomb": (bomb, "it unpacks to 33554560 bytes, and "),
    "8 TB in a header": (lie, "'state.mean' is no array, or not of the size that it says"),
    "objects": (lambda path: lie(path, (8,), "|O"), "'state.mean' is no array, or not of the size that it"),
    "pickles": (
        lambda path: np.savez(path, mean=np.array([{}], dtype=object)),
        "'mean' is no array, or not of the size that it says",
    ),
    "one name twice": (twice, "'format' is there twice"),
    "another version": (no_zip_in_zip, "(9, 0)"),
    "text": (lambda path: path.write_text("no state"), "File is not a zip file"),
    "nothing": (lambda path: path.write_bytes(b""), "File is not a zip file"),
    "one array": (lambda path: np.save(path.open("wb"), np.zeros(3)), "File is not a zip file"),
}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("write", "message"), ARCHIVES.values(), ids=ARCHIVES)
def test_no_archive_costs_memory_or_runs_anything(write, message, tmp_path):
    path = tmp_path / "feet.npz"
    write(path)
    with pytest.raises(ValueError, match=rf"is not a saved state: .* damaged \({re.escape(message)}"):
        make().load(path)


def device(path):
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")


def bound(path):
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def link_to_pipe(path):
    os.mkfifo(path.with_suffix(".pipe"))
    path.symlink_to(path.with_suffix(".pipe"))


NO_FILES = {
    "a device": (device, "is a device, pipe or socket, not a regular file"),
    "a folder": (os.mkdir, "is a folder, not a regular file"),
    "a pipe": (os.mkfifo, "is a device, pipe or socket, not a regular file"),
    "a socket": (bound, "is a device, pipe or socket, not a regular file"),
    "a link to a pipe": (link_to_pipe, "is a device, pipe or socket, not a regular file"),
}


@pytest.mark.parametrize(("make_it", "message"), NO_FILES.values(), ids=NO_FILES)
def test_what_is_no_file_is_neither_replaced_nor_read(make_it, message, log, row, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    path = Path("feet.npz")
    make_it(path)
    before, there = os.lstat(path), sorted(os.listdir())
    calibrator = make("none")
    calibrator.update(log.raw[0], row(0))
    for use in (
        calibrator.save,
        calibrator.load,
        lambda p: write_text(p, "text"),
        lambda p: read_arrays(p, 1),
    ):
        with pytest.raises(ValueError, match=rf"^'feet\.npz' {message}; give the path of a file\.$"):
            use(path)
    after = os.lstat(path)
    assert (after.st_ino, after.st_mode, after.st_rdev) == (before.st_ino, before.st_mode, before.st_rdev)
    assert sorted(os.listdir()) == there


@pytest.mark.parametrize("path", [None, 1, True, b"feet.npz", ["feet.npz"]])
def test_what_is_no_path_is_no_open_file(path, log, row):
    calibrator = make("none")
    calibrator.update(log.raw[0], row(0))
    for use in (calibrator.save, calibrator.load):
        with pytest.raises(
            TypeError, match=rf"A path must be a str or a Path, got {re.escape(repr(path))} of "
        ):
            use(path)


def test_links_are_followed_and_modes_stay(tmp_path):
    real, link, loop = tmp_path / "real.txt", tmp_path / "link.txt", tmp_path / "loop.txt"
    write_text(real, "one")
    real.chmod(0o600)
    link.symlink_to(real)
    loop.symlink_to(loop)
    write_text(link, "two")
    assert link.is_symlink()
    assert real.read_text() == "two"
    assert stat.S_IMODE(real.stat().st_mode) == 0o600
    with pytest.raises(OSError, match="symbolic links"):
        write_text(loop, "three")
    real.unlink()
    write_text(link, "made where it leads to, in a name of any length")
    write_text(tmp_path / ("é" * 120 + ".txt"), "long")
    with pytest.raises(ValueError, match=r"^'a\\x00b' cannot be the name of a file\.$"):
        write_text("a\0b", "text")
    assert real.is_file()
    assert len(list(tmp_path.iterdir())) == 4


def test_a_full_disk_costs_the_new_file_alone(log, row, tmp_path):
    calibrator = make()
    calibrator.update(log.raw[0], row(0))
    calibrator.save(tmp_path / "feet.npz")
    before, limits = (tmp_path / "feet.npz").read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    calibrator.update(log.raw[1], row(1))
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            calibrator.save(tmp_path / "feet.npz")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "feet.npz").read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["feet.npz"]


KILLED = """
import os, signal, sys
from surefoot.files import atomic_path
with atomic_path(sys.argv[1]) as part:
    part.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_save_leaves_goes_with_the_next_one(tmp_path):
    path = tmp_path / "feet.npz"
    write_text(path, "old")
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 2
    with atomic_path(path) as mine:
        mine.write_text("mine")
        write_text(path, "theirs")  # another process, say: it leaves alone what is being written
        assert mine.is_file()
    assert path.read_text() == "mine"
    assert [file.name for file in tmp_path.iterdir()] == ["feet.npz"]


STREAM = {
    "nothing came": ({"raw": np.nan}, Flag.MISSING),
    "infinite": ({"raw": np.inf}, Flag.OUT_OF_RANGE),
    "1e300": ({"raw": 1e300}, Flag.OUT_OF_RANGE),
    "-1e300": ({"raw": -1e300}, Flag.OUT_OF_RANGE),
    "no time": ({"dt": 0.0}, Flag.GAP),
    "time backwards": ({"dt": -1.0}, Flag.GAP),
    "time is NaN": ({"dt": np.nan}, Flag.GAP),
    "time is infinite": ({"dt": np.inf}, Flag.GAP),
    "com is NaN": ({"com": np.nan}, Flag.REFERENCE),
    "com is 1e30": ({"com": 1e30}, Flag.REFERENCE),
    "com is in mm": ({"com": 250.0}, Flag.REFERENCE),
    "soles are infinite": ({"position_sole": np.inf}, Flag.REFERENCE),
    "rotation is -1e30": ({"R_level_sole": -1e30}, Flag.REFERENCE),
}


@pytest.mark.parametrize(("change", "flag"), STREAM.values(), ids=STREAM)
def test_in_a_stream_it_is_a_flag_and_an_estimate_that_stays(change, flag, log, row):
    for method in ("moment", "tare"):
        calibrator = make(method)
        before = [calibrator.update(log.raw[k], row(k)) for k in range(8)][-1]
        raw = np.full(8, change["raw"]) if "raw" in change else log.raw[8]
        beliefs = {name: np.full_like(getattr(row(8), name), value) for name, value in change.items()
                   if name in Reference._fields}  # fmt: skip
        estimate = calibrator.update(raw, row(8)._replace(**beliefs), change.get("dt", DT))
        assert (estimate.flags & flag).all()
        np.testing.assert_array_equal(estimate.scale, before.scale)
        np.testing.assert_array_equal(estimate.offset, before.offset)
        assert np.isfinite(estimate.force).all()


BELIEFS = Reference(*[np.zeros((2, 1))] * len(Reference._fields))
SETUP = {"layout": LAYOUT, "mass": MASS, "initial": NOMINAL}
ARGUMENTS = {
    "no layout": (
        lambda: FootCalibrator(None, mass=5.0),
        "'layout' must be a FeetLayout, got None of NoneType.",
    ),
    "a setup without one": (
        lambda: OnlineSetup(**SETUP | {"layout": "nao"}),
        "'layout' must be a FeetLayout, got 'nao' of str.",
    ),
    "a text for a time": (lambda: make(dt="1"), "'dt' must be a number, got '1' of type str."),
    "no time": (lambda: make(dt=None), "'dt' must be a number, got None of type NoneType."),
    "a list for a mass": (lambda: make(mass=[1]), "'mass' must be a number, got [1] of type list."),
    "no method": (
        lambda: make(None),
        "'method' must be a name, such as 'moment', or its options, such as "
        "Moment(scale_std=0.2), got None of NoneType.",
    ),
    "methods": (
        lambda: make(["moment"]),
        "'method' must be a name, such as 'moment', or its options, such as "
        "Moment(scale_std=0.2), got ['moment'] of list.",
    ),
    "no map": (lambda: make(initial=(1, 2)), "'initial' must be Parameters(scale, offset), got tuple."),
    "scales of zero": (
        lambda: make(initial=Parameters(np.zeros(8), np.zeros(8))),
        "'initial.scale' must not be zero, got [0. 0. 0. 0. 0. 0. 0. 0.].",
    ),
    "a range of one": (
        lambda: make("window", scale_range=1.0),
        "'scale_range' must enclose 1 and be positive, got 1.0.",
    ),
    "a replay without beliefs": (
        lambda: replay(LAYOUT, "none", np.zeros((2, 8)), None, DT, mass=MASS),
        "'reference' must be a Reference, got None of NoneType.",
    ),
    "a replay without a robot": (
        lambda: replay(None, "none", np.zeros((2, 8)), BELIEFS, DT, mass=MASS),
        "'layout' must be a FeetLayout, got None of NoneType.",
    ),
    "a replay without time": (
        lambda: replay(LAYOUT, "none", np.zeros((2, 8)), BELIEFS, "1", mass=MASS),
        "'dt' must be a number, got '1' of type str.",
    ),
}


@pytest.mark.parametrize(("call", "message"), ARGUMENTS.values(), ids=ARGUMENTS)
def test_arguments_are_refused_at_the_door(call, message):
    with pytest.raises((TypeError, ValueError)) as refused:
        call()
    assert str(refused.value) == message


def test_a_text_for_the_time_of_a_sample_is_refused_and_nothing_is_learnt(log, row):
    calibrator = make("tare")
    calibrator.update(log.raw[0], row(0))
    before = calibrator.state
    with pytest.raises(TypeError, match=r"^'dt' must be a number, got '1' of type str\.$"):
        calibrator.update(log.raw[1], row(1), "1")
    for a, b in zip(before[1:], calibrator.state[1:], strict=True):
        np.testing.assert_array_equal(a, b)
