import pytest


@pytest.fixture(params=["foot", "leg"])
def sensor(request):
    """Each sensor of the in-situ paper, a key of ``SENSORS`` in ``_in_situ.py``."""
    return request.param
