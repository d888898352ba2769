"""What the demo's page says in its own words; numbers come in from outside."""

from typing import Any

__all__ = ["CAPTIONS", "TEXTS", "say"]

TEXTS = {
    "introduction": """
        A NAO-class biped of 5.3 kg walks in MuJoCo on eight load cells, four under each foot, whose
        gains and zeros are wrong and drift. Every walk was recorded once, and the same stream of counts
        went through every calibration method: the moment filter, the sliding window of the CoP
        paper, Han's quasi-static method, a tare in swing, and none at all. The methods were told what a
        robot knows (late and noisy encoders and IMU, and a model of itself whose mass and centre of mass
        are off), never the truth; the truth is used here to score them.""",
    "amount": """
        {seeds} seeds at each of {speeds} speeds, walks of {duration:g} s of which the first {stand:g} s
        are standing; errors count from {settle:g} s on. All intervals are 95 % intervals of the mean
        over seeds (Student t).""",
    "summary": "What was set out to be reached, and what this run measured.",
    "bench": """
        Before a robot walks, known weights stand on each cell and then at holes 1 cm apart on each
        foot's plate. A line per cell (Eqs. 1, 2) and a correction of the centre of pressure (Eqs. 3-5)
        are fitted, and scored at holes that the fit never saw.""",
    "conditions": """
        Two conditions. {paper}: the cells were calibrated on the bench before the walk and drift mildly
        since (0.5 % in gain and 0.2 N in zero per square root of a minute); methods start from the
        bench calibration. {bad}: never calibrated (gains off by 12 %, zeros by 1.5 N, one standard
        deviation) and drifting by 2 % and 1 N per square root of a minute; methods start from the data
        sheet.""",
    "yardsticks": """
        Two yardsticks. Against the baseline, as the paper scores: the bench calibration applied to the
        same counts stands for the truth. In that scoring doing nothing is perfect by construction where
        a method starts from the bench, and a method is charged for following the drift. Against the
        truth: MuJoCo's cell forces at the moment at which the host reads.""",
    "definitions": """
        CoP is the centre of pressure of both feet in the world, sqrt(mean(ex² + ey²)), with the true
        poses of the soles on both sides, wherever more than 5 N press on the ground; vGRF is the
        vertical force of both feet together; a single cell is the error over all cells. The floor is
        the map that would undo each cell's gain and zero at every moment: what it leaves comes from
        noise and from chips that convert at times of their own, so that readings are up to 13 ms old,
        and no calibration of gains and zeros can remove it. The reference is what the robot's motion
        asks for (Eqs. 9-11), against the truth of the moment that it describes.""",
    "loop": """
        The stabiliser holds the centre of pressure in its observation against the planned one and moves the
        ankles. It is the same controller every time and begins with the first step, after {stand:g} s of
        standing; only the feet it feels differ. Severity 1 is the bad start of above (gains off by 12 %,
        zeros by 1.5 N, drift 2 % and 1 N per square root of a minute), severity 3 three times that; there are
        small pushes, and the ground's friction
        is drawn. What the walker tolerates depends on the controller: it balances on its tilt as well.""",
    "sensitivity": """
        The paper scales each of the window's weights (Eq. 14) by 0.2 to 5 and reports that little
        changes. So did we, on the same logs: w_F of the vertical force, w_P of the centre of pressure,
        w_S of the parameters' smoothness.""",
    "repeat": """
        A cell of any table is one seeded walk. The logs hold everything that the tables were made of;
        docs/log-format.md describes their columns. All single figures are in tables/*.csv, and
        results.json says how the demo was run.""",
}
"""Paragraphs."""

CAPTIONS = {
    "bench_cop": """
        Measured centres of pressure (dots) against the holes in which the weights stood (rings): left
        foot, held-out holes, weights from 1 kg on. Left by the data sheet's coefficients, right after
        the calibration: the dots sit in their rings.""",
    "bench_vgrf": """
        Vertical force of held-out placements on both feet, sorted by weight; below, the size of the
        error on a logarithmic axis.""",
    "overview": """
        Mean errors with their 95 % intervals on logarithmic axes; bars without a marker are the figures
        that the paper prints. Left as the paper scores; the other two against the truth.""",
    "errors_over_time": """
        Error of the centre of pressure against the truth in pieces of 2 s; lines are medians and bands
        quartiles over seeds. A curve that falls and stays down is a calibrator that converges; the
        dotted floor is what the best map of each moment leaves.""",
    "cop": """
        Centre of pressure at {speed:g} m/s, seed 0: forward, to the left, and its distance to the truth
        on a logarithmic axis. Black is MuJoCo's truth. The nearer a colour stays to black, and the
        lower it lies in the last row, the better.""",
    "vgrf": """
        Vertical force at {speed:g} m/s, seed 0: both feet together above, the left foot alone below. A
        foot in the air should read zero; where a colour does not, its zero is wrong.""",
    "film": """
        The same robot and seed twice (severity {severity:g}, {speed:g} m/s, seed {seed}): left on drifting
        raw feet, right on feet that surefoot calibrates. Below, the soles from above: the black dot is
        the true
        centre of pressure, the coloured one that which the controller is given.""",
    "closed_loop": """
        Above, the share still walking; below, every single walk, a cross where it fell and a ring where
        it reached the end.""",
    "weights": "Errors against the factor on one weight; bands are 95 % intervals.",
}
"""Captions: they state what to see."""


def say(text: str, **values: Any) -> str:
    """Write a text on one line, with its numbers.

    >>> say('''from {start:g} s
    ...        on''', start=2.0)
    'from 2 s on'
    """
    return " ".join(text.split()).format(**values)
