"""The benchmark of the native step: its program makes the forces of the wrappers, and says where not."""

import numpy as np
import pytest

from surefoot.native import CALIBRATION, compiler

STEPS = 64

pytestmark = pytest.mark.skipif(
    compiler() is None or CALIBRATION.installed() is None, reason="needs a C compiler"
)


@pytest.fixture(scope="module")
def script(benchmark_script):
    benchmark_script("step")  # which it imports
    found = benchmark_script("native_step")
    found.FLAGS = ("-std=c99", "-O0", "-ffp-contract=off")  # compiles in a second
    return found


@pytest.mark.slow
def test_it_tells_a_row(script, capsys):
    script.main(["--steps", str(STEPS), "--robots", "2", "--rounds", "1"])
    rows = [row.split(" | ") for row in capsys.readouterr().out.splitlines()[2:]]
    assert len(rows) == 1
    for row in rows:
        whole, *parts = (float(word.rstrip(" |")) for word in row[1:] if word.strip())
        assert 0.0 < whole < 1e4
        assert len(parts) == len(script.PARTS)


def test_other_forces_than_those_of_the_recording_stop_it(script, tmp_path):
    source, rows, forces = script.walk(STEPS)
    program, data = script.compile_program(source, tmp_path), tmp_path / "walk"
    rows.tofile(data)
    script.check(program, data, forces)
    forces[50, 3] += 1e-6
    with pytest.raises(SystemExit, match="at step 50 it made"):
        script.check(program, data, forces)
    assert np.isfinite(forces).all()
