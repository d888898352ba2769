"""Device of the tests of GPU modules: SUREFOOT_DEVICE=cuda pytest tests/wrappers/test_gpu_*.py."""

import os

import pytest
import torch

warp = pytest.importorskip("warp", "1.19", reason="GPU modules need Warp: pip install 'surefoot[gpu]'")

DEVICE = torch.empty(0, device=os.environ.get("SUREFOOT_DEVICE", "cpu")).device
"""With its number, as tensors made on it have it."""

if DEVICE.type == "cpu":
    # To optimise the moment filter takes half a minute of a core, for tests of two seconds.
    warp.config.optimization_level = 0
