"""What holds for all tests."""

import gc
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))


def pytest_collection_finish() -> None:
    """Keep what was imported (torch, pandas, matplotlib) out of every garbage collection to come."""
    gc.freeze()
