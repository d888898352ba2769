"""Device of the tests of GPU modules: SUREFOOT_DEVICE=cuda pytest tests/wrappers/test_gpu_*.py."""

import os

import torch

DEVICE = torch.empty(0, device=os.environ.get("SUREFOOT_DEVICE", "cpu")).device
"""With its number, as tensors made on it have it."""
