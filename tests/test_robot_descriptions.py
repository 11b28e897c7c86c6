"""Models of the package robot_descriptions: a stand-in of the package, and its absence."""

import importlib
import sys
from pathlib import Path

import pytest
from discovery_hands import make_hand, urdf

from smooth_operator.hands.registry import load_hand

MODULE = """
print("Cloning a repository...")
URDF_PATH = {path!r}
"""


@pytest.fixture
def package(tmp_path, elsewhere, own_hands, monkeypatch) -> Path:
    """A package with a hand, one whose download fails, and one without a model."""
    for name in [n for n in sys.modules if n.partition(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    model = tmp_path / "cache/gadget_repository/gadget.urdf"
    model.parent.mkdir(parents=True)
    model.write_text(urdf(make_hand(3).parts))
    folder = tmp_path / "site/robot_descriptions"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "_cache.py").touch()
    (folder / "gadget_description.py").write_text(MODULE.format(path=str(model)))
    (folder / "broken_description.py").write_text("raise RuntimeError('no route to\\nhost')")
    (folder / "template_description.py").write_text("XACRO_PATH = 'hand.xacro'")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    importlib.invalidate_caches()
    return folder


@pytest.mark.parametrize("name", ["gadget", "gadget_description"])
def test_a_description_is_added_by_its_name(run, package, name):
    status, out, err = run("hands", "add", f"robot_descriptions:{name}", "--json")
    assert status == 0, err
    assert out.startswith("{")  # what the package prints goes to standard error
    assert "Cloning" in err
    assert load_hand("gadget").fingers[0] == "thumb"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gadgit", "Did you mean 'gadget'?"),
        ("broken", "can't download 'broken': no route to host. Try again with a network"),
        ("template", "neither an MJCF nor a URDF file"),
    ],
)
def test_a_description_that_can_not_be_used_is_refused(run, package, name, message):
    status, _, err = run("hands", "add", f"robot_descriptions:{name}")
    assert (status, message in err, "Traceback" in err) == (2, True, False), err


def test_without_the_package_its_install_command_is_printed(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    status, _, err = run("hands", "add", "robot_descriptions:gadget")
    assert (status, err.count("\n")) == (2, 1), err
    assert "python -m pip install robot_descriptions" in err
