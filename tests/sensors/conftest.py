"""What tests of sensors share."""

import pytest
from _native import library_of

from surefoot.native import SENSORS, Library


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """Give the library of sensors, compiled if there is none."""
    return library_of(SENSORS, tmp_path_factory.mktemp("native"))
