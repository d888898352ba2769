"""Recordings of real sensors, which are not part of the package."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("SUREFOOT_DATA") or "nowhere")


def needs(folder: str) -> pytest.MarkDecorator:
    reason = "the environment variable SUREFOOT_DATA names no folder with real recordings"
    return pytest.mark.skipif(not (DATA / folder).is_dir(), reason=reason)
