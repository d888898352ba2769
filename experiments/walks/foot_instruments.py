"""The instruments under a recorded robot's feet: load cells, six-axis sensors at the ankles, or both.

Each kind draws from a random stream of its own, so that conditions which share a kind share its readings.
"""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from surefoot.calibration import Parameters
from surefoot.envs import RobotDrawing
from surefoot.experiments.arrays import Floats
from surefoot.experiments.weights.weighing import run_weighing
from surefoot.robot.sensing.instruments import Instruments, SensorsInAnkles
from surefoot.sensors import ForceTorque, LoadCells

_STREAM = 0x10605  # keeps the instruments' randomness apart from every other stream with the same seed


class FootInstruments:
    """What one condition reads under one walk, by a random stream of an ``index``.

    ``nominal`` and ``calibrated`` are maps of K channels, by the data sheets and from weights before the walk
    (``None`` unless there are load cells alone); ``about`` says what maps axis by axis leave out: cross-talk,
    and the weight that counts as part of the zero.
    """

    def __init__(
        self,
        cells: LoadCells | None,
        ankle: ForceTorque | None,
        *,
        index: int,
        seed: int,
        truth: Any,
        drawing: RobotDrawing,
        dt: float,
    ) -> None:
        if cells is None and ankle is None:
            raise ValueError("A condition needs load cells, ankle sensors or both, and has neither.")
        devices = tuple(device for device in (cells, ankle) if device is not None)
        self._all = Instruments(devices, drawing, dt)
        self.layout, self.nominal = self._all.layout, self._all.nominal
        self.calibrated: Parameters | None = None
        self.about: dict[str, Any] = {}
        self._streams: list[np.random.Generator] = []
        self._states: list[Any] = []
        for part in self._all.parts:
            in_ankles = isinstance(part, SensorsInAnkles)
            rng = np.random.default_rng([_STREAM, index, seed, 1] if in_ankles else [_STREAM, index, seed])
            state: Any = part.init(rng)
            if cells is not None and not in_ankles:
                if ankle is None:
                    self.calibrated = run_weighing(cells=cells, state=state, seed=seed).channels.value
                # Every chip delivers once before the walk, as they do while a robot boots.
                _, state = part.read(truth, state, rng, 1.0 / cells.rate[0] if cells.rate else 0.0125)
            self._streams.append(rng)
            self._states.append(state)
        if ankle is not None:
            self._note_ankles()
        self._raw: list[Floats] = []
        self._force: list[Floats] = []
        self._maps: list[tuple[Floats, Floats]] = []

    def read(self, truth: Any, dt: float) -> None:
        """Take the readings after a control step."""
        readings, forces, maps = [], [], []
        part: Any
        for i, part in enumerate(self._all.parts):
            reading, self._states[i] = part.read(truth, self._states[i], self._streams[i], dt)
            readings.append(reading)
            forces.append(part.force(truth))
            maps.append(part.true_map(self._states[i]))
        self._raw.append(self._all.joined(readings))
        self._force.append(self._all.joined(forces))
        self._maps.append(
            (self._all.joined([m.scale for m in maps]), self._all.joined([m.offset for m in maps]))
        )

    @property
    def raw(self) -> Floats:
        """All readings in counts, shape (N, K)."""
        return np.array(self._raw)

    @property
    def force(self) -> Floats:
        """What the calibrated channels should have read in N and N m, shape (N, K)."""
        return np.array(self._force)

    @property
    def maps(self) -> Floats:
        """The maps that would have undone each channel's own errors, (scale, offset), shape (N, 2, K)."""
        return np.array(self._maps)

    def _note_ankles(self) -> None:
        blocks, preload = [], []
        for part, state in zip(self._all.parts, self._states, strict=True):
            if isinstance(part, SensorsInAnkles):
                blocks.append(part.cross_talk(state))
                preload.append(part.preload)
            else:
                blocks.append(np.zeros((part.channels, part.channels)))
                preload.append(np.zeros(part.channels))
        order = self._all.order
        talk = block_diag(*blocks)
        self.about = {
            "truth_cross_talk": talk[np.ix_(order, order)].tolist(),
            "truth_preload": self._all.joined(preload).tolist(),
        }
