"""The documentation is true: its Python runs, its links lead somewhere, its tables hold."""

import importlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_architecture import LEVELS

from smooth_operator import Status, landmarks
from smooth_operator.errors import MissingExtraError
from smooth_operator.metrics.table import METRICS

PROJECT = Path(__file__).resolve().parents[1]
README = PROJECT / "README.md"
PAGES = [
    README,
    *(p for top in ("docs", "research", "packages") for p in sorted((PROJECT / top).rglob("*.md"))),
]
SOURCE = PROJECT / "src" / "smooth_operator"
RESEARCH = PROJECT / "research" / "src" / "smooth_operator_research"
BENCHMARK = PROJECT / "packages" / "smooth_operator_benchmark" / "smooth_operator_benchmark"
STUDY = PROJECT / "packages" / "smooth_operator_study" / "smooth_operator_study"
DATA_SETS = PROJECT / "packages" / "smooth_hand_datasets" / "smooth_hand_datasets"
DEVICES = PROJECT / "packages" / "smooth_operator_devices" / "smooth_operator_devices"
"""Names that are no modules."""
NO_MODULES = {
    *("json", "method", "origin"),  # a file of data sets, metadata records of the log
    *("sources", "sinks", "readers", "commands", "methods", "feedbacks", "writers"),  # entry points
}
"""Second parts of names that are no modules."""
SKIP = "<!-- no-test -->"
FENCE = re.compile(r"^(?P<fence>`{3,}|~{3,})(?P<language>[\w+-]*)")


def python_blocks(text: str) -> Iterator[tuple[int, str]]:
    """(line of its first statement, code) of each ``python`` block that is not marked with SKIP."""
    lines = iter(enumerate(text.splitlines(), 1))
    before = ""
    for number, line in lines:
        if opening := FENCE.match(line):
            body = []
            for _, inner in lines:
                if inner.strip() == opening["fence"]:
                    break
                body.append(inner)
            if opening["language"] == "python" and before != SKIP:
                yield number + 1, "\n".join(body)
        before = line.strip() or before


def relative_name(path: Path) -> str:
    return path.relative_to(PROJECT).as_posix()


def runnable(page: Path) -> list[tuple[int, str]]:
    return list(python_blocks(page.read_text(encoding="utf-8")))


def test_blocks_are_found_in_order_and_skipped_where_marked():
    text = (
        f"```python\na\n```\n{SKIP}\n\n```python\nb\n```\n```bash\nc\n```\n````python\n```\n````\n"
    )
    assert list(python_blocks(text)) == [(2, "a"), (13, "```")]
    assert runnable(README), "README.md needs a ```python block: from landmarks to a command"


@pytest.mark.parametrize("page", list(filter(runnable, PAGES)), ids=relative_name)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    """In the order of the page, in one namespace, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    namespace: dict[str, object] = {"__name__": "__main__"}
    for line, code in runnable(page):
        # Blank lines in front, so that a traceback names the line of the page.
        padded = "\n" * (line - 1) + code
        exec(compile(padded, str(page), "exec", dont_inherit=True), namespace)


def test_commands_of_the_readme_are_those_of_ci_home_and_tutorial():
    readme = README.read_text(encoding="utf-8")
    (command,) = re.findall(
        r"^ *(python3 -m venv .*-m pytest\b.*?)(?: \|\| exit)?$",
        (PROJECT / ".ci" / "run").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert command in readme, f"README.md does not give: {command}"
    install = re.compile(r"^python3 -m venv .*smooth-operator demo$", re.MULTILINE)
    for page in ("index.md", "tutorials/first-steps.md"):
        text = (PROJECT / "docs" / page).read_text(encoding="utf-8")
        assert install.findall(text) == install.findall(readme) != []


@pytest.mark.parametrize(
    "page", [*PAGES, PROJECT / "CONTRIBUTING.md", PROJECT / "SECURITY.md"], ids=relative_name
)
def test_what_a_page_names_exists(page):
    """Links into the project, dotted names of the packages, and paths of Python files."""
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"^(`{3,}).*?^\1", "", text, flags=re.M | re.S)
    targets = re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", prose)
    links = ["".join(target).split("#")[0] for target in targets]
    local = [link for link in links if not re.match(r"[a-z]+:|$", link)]
    absent = [link for link in local if not (page.parent / link).exists()]
    named = re.findall(
        r"\bsmooth_operator(?:_research|_benchmark|_study|_devices)?(?:\.(?!md\b)\w+)+", text
    )
    own = {name for name in named if name.split(".")[1] not in NO_MODULES}
    absent += [name for name in sorted(own) if not resolves(name)]
    paths = set(re.findall(r"`((?:\w+/)+\w+\.py)\b", text))
    places = (SOURCE, PROJECT, PROJECT / "research", RESEARCH, DATA_SETS, BENCHMARK, STUDY, DEVICES)
    absent += [path for path in sorted(paths) if not any((p / path).is_file() for p in places)]
    assert absent == []


@pytest.mark.parametrize("page", PAGES, ids=relative_name)
def test_sections_with_figures_name_their_command(page):
    """A section with three rows of decimals or more says which command or program prints them."""
    command = re.compile(
        r"smooth-operator \w|python (-m|research/benchmarks)|`[\w/]+\.py`|smooth_operator_research"
    )
    decimals = re.compile(r"^\|.*\d\.\d.*\d\.\d", re.MULTILINE)
    sections = re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    figures = [text for text in sections if len(decimals.findall(text)) >= 3]
    assert [text.splitlines()[0] for text in figures if not command.search(text)] == []


def test_landmark_table_is_the_code():
    """Names and indices in each tracker, as in ``docs/reference/conventions.md``."""
    text = (PROJECT / "docs" / "reference" / "conventions.md").read_text(encoding="utf-8")
    pattern = r"^\| (?:–|\w+) \| (`[^|]+`) \| (\d+)(?:–(\d+))? \| (\d+)(?:–(\d+))? \|$"
    names: list[str] = []
    nodes: list[int] = []
    for cell, first, last, first_node, last_node in re.findall(pattern, text, re.MULTILINE):
        assert int(first) == len(names)
        names += re.findall(r"`(\w+)`", cell)
        nodes += range(int(first_node), int(last_node or first_node) + 1)
        assert int(last or first) == len(names) - 1
    assert tuple(names) == landmarks.LANDMARKS
    bases = [int(node) for node in re.findall(r"nodes (\d+), (\d+), (\d+) and (\d+)", text)[0]]
    for tracker, carpals, shift in (
        (landmarks.FROM_MANUS_25, landmarks.METACARPALS_MANUS_25, 0),
        (landmarks.FROM_WEBXR_25, landmarks.METACARPALS_WEBXR_25, 0),
        (landmarks.FROM_OPENXR_26, landmarks.METACARPALS_OPENXR_26, 1),
    ):
        assert list(tracker) == [node + shift for node in nodes]
        assert list(carpals) == [node + shift for node in bases]


def test_status_table_is_the_code():
    text = (PROJECT / "docs" / "reference" / "conventions.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| `([A-Z_]+)` \| (.+?) \|$", text, re.MULTILINE)
    assert rows == [(str(int(status)), status.name, status.reason) for status in Status]


def test_defined_metrics_are_the_code():
    """Names and better values in the section Metrics of ``docs/reference/conventions.md``."""
    text = (PROJECT / "docs" / "reference" / "conventions.md").read_text(encoding="utf-8")
    section = text.split("\n## Metrics\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.+?) \| .+ \| ([01; ]+) \|$", section, re.MULTILINE)
    best = {metric.name: "0" if metric.goal == "down" else "1" for metric in METRICS}
    assert len(rows) == section.count("\n| `")
    for cell, better in rows:
        names = re.findall(r"`([\w.]+)`", cell)
        values = better.split("; ")
        assert [best.get(name) for name in names] == values * (len(names) // len(values)), cell


def test_level_table_is_the_test_of_imports():
    text = (PROJECT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| \w+ \| ([^|]+) \|", text, re.MULTILINE)
    found = {name: int(level) for level, names in rows for name in re.findall(r"`(\w+)`", names)}
    assert found.items() <= LEVELS.items()
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert packages - found.keys() == set()


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError as error:
            if error.name is None or not error.name.startswith("smooth_operator"):
                return True  # it needs an extra that is not installed
            continue
        except MissingExtraError:
            return True
        return all(hasattr(found, parts[end]) for _ in parts[end : end + 1])
    return False


OWN_NAMES = r"smooth[-_](?:retargeting|operator|hand)(?!-\*\.whl)|lerobot_\w+"
INSTALLS = [
    *PAGES,
    *(PROJECT / name for name in ("CONTRIBUTING.md", "SECURITY.md", "NOTICES.md", "CITATION.cff")),
    *sorted((PROJECT / "packages").glob("*/README.md")),
    *sorted((PROJECT / "examples").rglob("*.md")),
    *sorted(
        path
        for top in ("src", "research/src", "packages", "examples")
        for path in (PROJECT / top).rglob("*.py")
        if "pip install" in path.read_text(encoding="utf-8")
    ),
]


def test_all_texts_install_from_the_clone():
    """None of the distributions is published; whoever takes a name could install anything.

    The name alone is in ``install_command``, for those who have it installed from a wheel.
    """
    published = re.compile(rf"pip install\b[^\n`]*(?<![./\w])(?:{OWN_NAMES})")
    texts = {relative_name(file): file.read_text(encoding="utf-8") for file in INSTALLS}
    assert [name for name, text in texts.items() if published.search(text)] == []


def test_folders_and_extras_of_install_lines_exist():
    projects = {
        path.parent: tomllib.loads(path.read_text(encoding="utf-8"))["project"]
        for path in PROJECT.rglob("pyproject.toml")
        if ".venv" not in path.parts
    }
    lines = [
        line
        for file in INSTALLS
        for line in re.findall(r"pip install ([^\n`]*)", file.read_text(encoding="utf-8"))
    ]
    targets = [
        match
        for line in lines
        for match in re.findall(r"(?<![\w.])(\.(?:/\w+)*)(?:\[([\w,-]+)\])?(?=[\"' ]|$)", line)
    ]
    assert len(targets) > 20
    for folder, extras in targets:
        project = projects[(PROJECT / folder).resolve()]
        known = project.get("optional-dependencies", {})
        assert [name for name in extras.split(",") if name and name not in known] == [], folder


def test_readme_is_short_and_lists_all_extras():
    text = README.read_text(encoding="utf-8")
    assert len(text.split()) < 900
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    section = text.split("\n## Extras\n")[1].split("\n## ")[0]
    assert set(project["optional-dependencies"]) - set(re.findall(r"`([\w-]+)`", section)) == set()


def test_every_built_in_hand_is_in_the_notices():
    text = (PROJECT / "NOTICES.md").read_text(encoding="utf-8")
    rows = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.+?) \|", text, re.MULTILINE))))
    models = {path.name.split(".")[0] for path in (SOURCE / "hands" / "models").glob("*.toml")}
    assert models - rows == set()
