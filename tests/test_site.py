"""The documentation site builds without a warning and holds every page and public name."""

import importlib.util
import os
import re
from pathlib import Path

import pytest
from processes import python

import smooth_hand_datasets.pipeline
import smooth_operator
import smooth_operator_benchmark
import smooth_operator_devices
import smooth_operator_study
from smooth_operator.hands import hand_names, load_hand

PROJECT = Path(__file__).resolve().parents[1]


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
    assert "<code>leap</code>" in cards[names.index("leap_hand")]  # its driver


def test_pages_need_no_script_for_equations_and_nothing_from_other_hosts(site):
    assert (site / "explanation" / "smooth" / "index.html").read_text("utf-8").count("<math ") > 20
    loaded = re.compile(r'<(?:script|img|iframe|link rel="(?:stylesheet|preload)")[^>]*https?://')
    for path in site.glob("**/*.html"):
        text = path.read_text(encoding="utf-8")
        assert "arithmatex" not in text, path
        assert loaded.search(text) is None, path
    assert [path for path in site.rglob("*") if path.suffix == ".pyc"] == []


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("smooth_operator", smooth_operator),
        ("datasets", smooth_hand_datasets.pipeline),
        ("benchmark", smooth_operator_benchmark),
        ("study", smooth_operator_study),
        ("devices", smooth_operator_devices),
    ],
)
def test_the_api_reference_has_every_public_name(site, name, package):
    page = (site / "reference" / "api" / name / "index.html").read_text(encoding="utf-8")
    documented = set(re.findall(rf'id="{package.__name__}\.[\w.]*?(\w+)"', page))
    assert sorted(set(package.__all__) - documented) == []
