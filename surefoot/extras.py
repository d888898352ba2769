"""Names that an extra of the package brings, loaded when asked for."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def not_installed(name: str, missing: ImportError, extra: str) -> ImportError:
    """Return the error that names the package to install for a module or function; one that does so stays."""
    if "surefoot" in str(missing):
        return missing
    return ModuleNotFoundError(
        f'{name} needs a package that is not installed ({missing}): pip install "surefoot[{extra}]".',
        name=missing.name,
    )


def names_of(
    package: str, modules: Mapping[str, str], extra: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package that loads a module when a name of it is asked for.

    ``modules`` has the module of each name; the ``extra`` brings the packages that they need.
    """

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            return getattr(import_module(modules[name]), name)
        except ModuleNotFoundError as missing:
            raise not_installed(f"{package}.{name}", missing, extra) from None

    return get, lambda: sorted({*vars(sys.modules[package]), *modules})
