"""The documentation site builds without a warning and holds every page and public name."""

import importlib.util
import json
import os
import re
from pathlib import Path

import pytest
from processes import python

import smooth_operator
import smooth_operator_devices
import smooth_operator_study
from smooth_operator.hands import hand_names, load_hand

PROJECT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(
    path.stem
    for path in (PROJECT / "docs" / "reference" / "api").glob("*.md")
    if (PROJECT / "src" / "smooth_operator" / path.stem).is_dir()
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; ``--strict`` turns each warning into a failure."""
    for module in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed (extra docs)")
    folder = tmp_path_factory.mktemp("site")
    words = ("-m", "mkdocs", "build", "--strict", "--site-dir", folder)
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = python(*words, cwd=PROJECT, env=quiet, check=True)
    assert "WARNING" not in done.stderr, done.stderr
    return folder


def test_every_page_is_in_the_site(site):
    pages = [p.relative_to(PROJECT / "docs") for p in (PROJECT / "docs").glob("**/*.md")]
    assert len(pages) > 20
    for page in pages:
        name = page.parent if page.name == "index.md" else page.with_suffix("")
        assert (site / name / "index.html").is_file(), page


def test_the_evidence_is_a_section_and_its_links_lead_into_the_site(site):
    """The strict build checks links between pages; here, that each path of a page is a link."""
    pages = [path.stem for path in (PROJECT / "research" / "docs").glob("*.md")]
    assert [name for name in pages if not (site / "evidence" / name / "index.html").is_file()] == []
    for page in site.glob("**/*.html"):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r'href="[^"]*research/docs/[^"]*', text) == [], page
        assert re.findall(r"(?<!\">)<code>(?:research/)?docs/[\w/-]+\.md<", text) == [], page


def test_home_shows_every_hand_with_picture_driver_and_licence(site):
    home = (site / "index.html").read_text(encoding="utf-8")
    cards = re.findall(r"<li>\s*<p><a href=\"reference/hands/\">.*?</li>", home, re.DOTALL)
    names = hand_names()
    assert [re.findall(r"<strong><code>(\w+)<", card) for card in cards] == [[n] for n in names]
    for name, card in zip(names, cards, strict=True):
        assert (site / "img" / "hands" / f"{name}.png").is_file()
        hand = load_hand(name, "right")
        joints = f"{len(hand.actuated)} of {len(hand.joint_names)} joints driven"
        assert joints in card
        assert "licence: " in card
    leap = cards[names.index("leap_hand")]
    assert ("<code>leap</code>" in leap, "licence: MIT" in leap) == (True, True)


def test_equations_are_mathml_and_need_no_script(site):
    page = (site / "explanation" / "smooth" / "index.html").read_text(encoding="utf-8")
    assert page.count("<math ") > 20
    for path in site.glob("**/*.html"):
        assert "arithmatex" not in path.read_text(encoding="utf-8"), path


def test_the_site_has_a_search_index(site):
    index = (site / "search" / "search_index.json").read_text(encoding="utf-8")
    assert "smooth_operator.retargeting" in index
    assert "load_hand" in index


def test_guides_rank_before_the_api_in_the_search(site):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    boosts: dict[str, set[float]] = {"how-to": set(), "reference/api": set()}
    for entry in index["docs"]:
        for top, values in boosts.items():
            if entry["location"].startswith(f"{top}/"):
                values.add(entry.get("boost", 1.0))
    assert min(boosts["how-to"]) > 10 * max(boosts["reference/api"])


def test_the_site_ships_no_bytecode_and_wraps_code(site):
    assert [
        path for path in site.rglob("*") if "pycache" in path.name or path.suffix == ".pyc"
    ] == []
    assert "site.css" in (site / "index.html").read_text(encoding="utf-8")
    assert "pre-wrap" in (site / "site.css").read_text(encoding="utf-8")


def test_the_site_loads_nothing_from_other_hosts(site):
    loaded = re.compile(r'<(?:script|img|iframe|link rel="(?:stylesheet|preload)")[^>]*https?://')
    for page in site.glob("**/*.html"):
        assert loaded.search(page.read_text(encoding="utf-8")) is None, page


def test_the_api_reference_has_every_public_name(site):
    page = (site / "reference" / "api" / "smooth_operator" / "index.html").read_text("utf-8")
    documented = set(re.findall(r'id="smooth_operator\.[\w.]*?(\w+)"', page))
    assert sorted(set(smooth_operator.__all__) - documented) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_a_page_of_its_modules(site, package):
    page = (site / "reference" / "api" / package / "index.html").read_text(encoding="utf-8")
    folder = PROJECT / "src" / "smooth_operator" / package
    modules = [path.stem for path in folder.glob("*.py") if path.stem != "__init__"]
    assert [name for name in modules if f"smooth_operator.{package}.{name}<" not in page] == []


def test_the_study_has_a_page_of_its_names_and_modules(site):
    page = (site / "reference" / "api" / "study" / "index.html").read_text(encoding="utf-8")
    documented = set(re.findall(r'id="smooth_operator_study\.[\w.]*?(\w+)"', page))
    assert set(smooth_operator_study.__all__) <= documented
    for name in ("analysis", "analysis.gee", "chunks", "commands.run", "design.plan"):
        assert f"smooth_operator_study.{name}<" in page


def test_the_devices_have_a_page_of_their_names_and_modules(site):
    page = (site / "reference" / "api" / "devices" / "index.html").read_text(encoding="utf-8")
    documented = set(re.findall(r'id="smooth_operator_devices\.[\w.]*?(\w+)"', page))
    assert set(smooth_operator_devices.__all__) <= documented
    for name in ("hands.drivers.dynamixel", "hands.guard", "ros2.sink", "commands.hardware"):
        assert f"smooth_operator_devices.{name}<" in page
