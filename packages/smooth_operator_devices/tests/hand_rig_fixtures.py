"""Fixtures with simulated hands; a test file takes them by ``pytest_plugins``."""

import contextlib
from collections.abc import Callable, Iterator

import pytest
from hand_rigs import LINKER_HANDS, RIGS, Rig, missing

from smooth_operator_devices.hands import bus_lock


@pytest.fixture
def rigs(tmp_path, monkeypatch) -> Iterator[Callable[..., Rig]]:
    """A function that makes a rig by its name, and skips the test if it can't be used here."""
    monkeypatch.setattr("smooth_operator_devices.hands.hardware_sink._RETRY_S", 0.02)
    # Locks of buses are files there. A pty that another run of the tests has lost, and still has
    # locked, gives its name to the next one.
    monkeypatch.setattr(bus_lock, "lock_folder", lambda: tmp_path)
    with contextlib.ExitStack() as stack:

        def make(name: str, side: str = "right", patience: float = 3.0) -> Rig:
            if why := missing(name):
                pytest.skip(why)
            rig = (RIGS | LINKER_HANDS)[name](tmp_path, monkeypatch, side)
            stack.callback(rig.close)
            rig.patience(patience)  # the machine may be busy
            return rig

        yield make


@pytest.fixture
def rig(request, rigs) -> Rig:
    """The rig of an indirect parameter."""
    return rigs(request.param)
