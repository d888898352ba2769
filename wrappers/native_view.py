"""What an agent is shown of one robot's feet, by the library: the same as :class:`FootView` shows."""

from typing import Any

from numpy.typing import NDArray

from surefoot.calibration.native import Library, NativeFilter
from surefoot.envs.observation import COP_BOUND
from surefoot.native import Record
from surefoot.wrappers.foot_view import FootView
from surefoot.wrappers.native_beliefs import NativeBeliefs


class NativeView:
    """The library for one robot; what is held is the Python object's own.

    Args:
        library: The library.
        view: The Python object.
        calibrator: The robot's calibrator.
    """

    def __init__(self, library: Library, view: FootView, calibrator: NativeFilter) -> None:
        self.calibrator, self._view, self._held = calibrator, view, view.held
        shapes = {name: space.shape or () for name, space in view.every.items()}
        config = library.filled(
            "view",
            {
                "force_bound": view.force_bound,
                "cop_bound": COP_BOUND,
                "weight": view.weight,
                "flawed": view.flawed,
            },
        )
        dtype = library.record("shown", shapes)
        assert dtype is not None
        assert config is not None
        self._config, self._shown = config, Record(dtype)
        self._show = library.functions.surefoot_view_show
        self._before = calibrator.config.ctypes.data, config.ctypes.data, view.held.ctypes.data

    def show(self, beliefs: NativeBeliefs, time: float) -> dict[str, NDArray[Any]]:
        """Show the calibrator's last estimate; as :meth:`FootView.show`.

        Args:
            beliefs: The robot's.
            time: The host's, for where the soles are.
        """
        beliefs.find_soles(time)
        self._show(
            *self._before, self.calibrator.estimate.address, beliefs.soles_address, self._shown.address
        )
        shown = self._shown.copy()
        return {part: shown[part] for part in self._view.parts}

    def __reduce__(self) -> Any:
        # Addresses are of no use elsewhere: a copy of the wrapper makes its own.
        return type(None), ()
