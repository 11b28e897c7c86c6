"""Fixtures that more than one test file uses."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real hand models and recordings beside the checkout, or a skip."""
    if not (SHARED / "recordings").is_dir():
        pytest.skip("the folder of real hands and recordings is not beside this checkout")
    return SHARED
