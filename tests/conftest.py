"""What holds for all tests."""

import gc


def pytest_collection_finish() -> None:
    """Keep what was imported (torch, pandas, matplotlib) out of every garbage collection to come."""
    gc.freeze()
