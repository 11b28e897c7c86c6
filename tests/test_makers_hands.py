"""Hands whose models stay in the repositories of their makers: ``hands add NAME --from CLONE``."""

import dataclasses
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from discovery_hands import make_hand, urdf

from smooth_operator.cli.hands_add import Add
from smooth_operator.errors import HandModelError
from smooth_operator.hand_files.makers_hands import makers_hand
from smooth_operator.hands.registry import HANDS, MAKERS_HANDS, load_hand

HAND = make_hand(3)
TEXT = urdf(HAND.parts).encode()
COUPLED, LEADER = (part.joint for part in reversed(HAND.parts[-3:-1]))
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def clone(tmp_path, elsewhere, own_hands, monkeypatch) -> Path:
    """Clone of a made-up maker's repository with one right hand, which the catalogue names."""
    entry = {
        "maker": "Acme",
        "repository": "https://example.org/acme/models",
        "commit": "c0ffee",
        "options": {"couple": [f"{COUPLED}={LEADER}*0.5"]},
        "right": {"file": "urdf/hand.urdf", "sha256": hashlib.sha256(TEXT).hexdigest()},
    }
    monkeypatch.setitem(MAKERS_HANDS, "acme", entry)
    folder = tmp_path / "models"
    (folder / "urdf").mkdir(parents=True)
    (folder / "urdf/hand.urdf").write_bytes(TEXT.replace(b"\n", b"\r\n"))  # as git on Windows
    return folder


def test_a_hand_is_added_from_a_clone_with_its_options(run: Run, clone):
    status, out, err = run("hands", "list")
    assert re.search(r"The model is in the maker's repository[^$]*\n acme .* Acme ", out), out
    with pytest.raises(HandModelError, match=r"add first: smooth-operator hands add acme$"):
        load_hand("acme")
    status, out, err = run("hands", "add", "acme", "--from", "models")
    assert (status, err) == (0, "")
    (coupling,) = (c for c in load_hand("acme").couplings if c.joint == COUPLED)
    assert (coupling.follows, coupling.multiplier) == (LEADER, 0.5)
    assert "Acme" not in run("hands", "list")[1]


def test_another_model_is_used_with_a_warning(run: Run, clone):
    (clone / "urdf/hand.urdf").write_bytes(TEXT.replace(b"<robot", b"<!-- new --><robot"))
    status, _, err = run("hands", "add", "acme", "--from", "models", "--name", "other")
    assert status == 0
    assert "hand.urdf differs from the model that was checked (commit c0ffee)" in err
    assert load_hand("other").name == "other"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["acme"],
            "git clone https://example.org/acme/models\n  git -C models checkout c0ffee\n  ",
        ),
        (["acme", "--from", "hands"], r"no urdf/hand.urdf in hands; expected a clone"),
        (["acme", "--side", "left"], "the maker of acme has published no model of the left hand"),
        (["models/urdf/hand.urdf", "--from", "models"], r"--from is for .*acme\), not for"),
    ],
)
def test_what_is_missing_is_named_with_the_commands_to_type(run: Run, clone, words, message):
    status, out, err = run("hands", "add", *words)
    assert (status, out) == (2, "")
    assert re.search(message, err), err


def test_the_catalogue_is_complete():
    options = {field.name for field in dataclasses.fields(Add)}
    for name, entry in MAKERS_HANDS.items():
        assert name not in HANDS
        for side in entry.keys() & {"right", "left"}:
            hand = makers_hand(name, side)
            assert re.fullmatch("https://github.com/[^/]+/[^/]+", hand.repository)
            assert re.fullmatch("[0-9a-f]{40} [0-9a-f]{64}", f"{hand.commit} {hand.sha256}")
            assert hand.options.keys() <= options - {"model", "side", "name", "from_"}, entry
