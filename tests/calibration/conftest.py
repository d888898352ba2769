import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(params=["foot", "leg"])
def sensor(request):
    """Each sensor of the in-situ paper, a key of ``SENSORS`` in ``_in_situ.py``."""
    return request.param
