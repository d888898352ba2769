"""What holds for all tests."""

import gc
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))


def pytest_collection_finish() -> None:
    """Keep what was imported (torch, pandas, matplotlib) out of garbage collections, which come seldom."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
