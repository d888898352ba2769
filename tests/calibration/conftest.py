import pytest


@pytest.fixture(params=["foot", "leg"])
def sensor(request):
    """Each sensor of the in-situ paper, a key of ``SENSORS`` in ``_in_situ.py``."""
    return request.param


@pytest.fixture(scope="session")
def single(tmp_path_factory):
    from surefoot.native import CALIBRATION
    from surefoot.native.build import FLAGS

    path = tmp_path_factory.mktemp("single") / "single.so"
    assert CALIBRATION.sources.compile(path, [*FLAGS, "-DSF_SINGLE"]) is None
    return CALIBRATION.load(path)
