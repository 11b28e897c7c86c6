"""The cross-hand matrix: its file, its runs, its tables, and a real trial."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smooth_operator import load_hand
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, DocumentError, HandModelError, UnknownNameError
from smooth_operator.source_digest import HOME
from smooth_operator_research.cross_hand import fixed_wrist, matrix, tables, trials
from smooth_operator_research.cross_hand.matrix import MatrixSettings, run_matrix, tracker_of
from smooth_operator_research.cross_hand.results import Cell, MatrixResults, Row, Trial
from smooth_operator_research.cross_hand.tables import Outcomes
from smooth_operator_research.cross_hand.trials import CEILING, Block, judge, play_block, run_block
from smooth_operator_research.paper.docs_tables import BLOCK

DONE = Trial(1.0, "done: turned by a right angle", "s", "b", 4.19)
LOST = Trial(0.0, "dropped: the cube fell", "d", "t", 1.5)
TINY = MatrixSettings(
    tasks=("cube",), hands=("leap_hand",), methods=("smooth", "ako"), worlds=4, workers=0
)


@pytest.fixture
def blocks(monkeypatch):
    """Replaces trials by simulated results: smooth succeeds, ako does not. Collects the blocks."""
    done = []

    def fake(block):
        done.append(block)
        rows = {tracker: Row() for _, tracker in block.worlds}
        for world, tracker in block.worlds:
            rows[tracker].trials[world] = DONE if "smooth" in block.method else LOST
        return rows

    monkeypatch.setattr(matrix, "run_block", fake)
    return done


def test_a_run_continues_a_file_and_a_larger_one_adds_worlds(blocks, tmp_path):
    path = tmp_path / "matrix.jsonl"
    assert run_matrix(TINY, path) == []
    assert [(block.method, len(block.worlds)) for block in blocks] == [
        ("smooth:teleop", 4),
        ("ako:published", 4),
    ]
    assert blocks[0].worlds == ((0, "glove"), (1, "headset"), (2, "camera"), (3, "glove"))
    content = path.read_bytes()
    run_matrix(TINY, path)
    assert (len(blocks), path.read_bytes()) == (2, content)
    run_matrix(replace(TINY, worlds=6), path)
    assert [block.worlds for block in blocks[2:]] == [((4, "headset"), (5, "camera"))] * 2
    glove = MatrixResults(path).of(Cell("cube", "leap_hand", "smooth:teleop", "glove"))
    assert [row.trials for row in glove.values()] == [{0: DONE, 3: DONE}]


def test_a_stopped_run_keeps_its_finished_blocks(blocks, monkeypatch, tmp_path):
    path, fake = tmp_path / "matrix.jsonl", matrix.run_block

    def interrupted(block):
        if "ako" in block.method:
            raise KeyboardInterrupt
        return fake(block)

    monkeypatch.setattr(matrix, "run_block", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_matrix(TINY, path)
    monkeypatch.setattr(matrix, "run_block", fake)
    run_matrix(TINY, path)
    assert [block.method for block in blocks] == ["smooth:teleop", "ako:published"]


def test_trials_by_older_code_are_repeated_unless_they_are_kept_and_marked(
    blocks, monkeypatch, tmp_path
):
    path = tmp_path / "matrix.jsonl"
    run_matrix(TINY, path)
    for module in (matrix, tables):
        monkeypatch.setattr(module, "trial_code", lambda *place: "newer")
    run_matrix(replace(TINY, worlds=5, keep_older=True), path)
    assert [block.worlds for block in blocks[2:]] == [((4, "headset"),)] * 2
    assert tables.OLDER in tables.success_table(Outcomes(MatrixResults(path)), "cube").rows[0][1]
    run_matrix(replace(TINY, worlds=5), path)
    results = MatrixResults(path)
    assert {code for _, code in results.rows} == {"newer"}
    assert not Outcomes(results).older
    assert sum(len(row.trials) for row in results.rows.values()) == 2 * 5


def test_a_hand_whose_scene_can_not_be_built_is_no_failure(monkeypatch, tmp_path):
    path = tmp_path / "matrix.jsonl"

    def too_small(task, hand):
        raise HandModelError(f"hand {hand.name!r} is too small")

    monkeypatch.setattr(trials, "scene_of", too_small)
    run_matrix(replace(TINY, methods=("smooth",), worlds=2), path)
    monkeypatch.undo()
    results = MatrixResults(path)
    assert [row.obstacle for row in results.rows.values()] == ["hand 'leap_hand' is too small"] * 2
    results.add(Cell("cube", "wuji_hand", "smooth:teleop", "glove"), "code", Row({0: DONE}))
    outcomes = Outcomes(results)
    cells = {row[0]: row[1] for row in tables.success_table(outcomes, "cube").rows}
    assert cells["`leap_hand`"] == "can't"
    assert cells["`wuji_hand`"].startswith("1.00 [0.21, 1.00]")
    assert tables.means_table(outcomes).rows[0] == ["cube", "1", "1.00 [1.00, 1.00]"]
    assert matrix.plan_blocks(replace(TINY, methods=("smooth",), worlds=2), results) == []


def test_the_page_has_a_place_for_every_table():
    page = Path(__file__).parents[1] / "docs" / "cross-hand.md"
    names = [match[1] for match in BLOCK.finditer(page.read_text(encoding="utf-8"))]
    assert sorted(names) == sorted({*tables.TABLES, *tables.SCALED_TABLES})


def test_trials_with_scaled_objects_have_their_own_tables(blocks, tmp_path):
    path = tmp_path / "matrix.jsonl"
    run_matrix(replace(TINY, tasks=("tongs",), worlds=1), path)
    run_matrix(replace(TINY, tasks=matrix.TASKS, scaled=True, worlds=3), path)
    assert {block.task for block in blocks[2:]} == {f"{task}:scaled" for task in matrix.PLANS}
    results = MatrixResults(path)
    for scaled, worlds in ((False, 1), (True, 3)):
        outcomes = Outcomes(results, scaled=scaled)
        assert not outcomes.older
        assert outcomes.successes("tongs", "smooth:teleop").shape == (1, worlds)


def test_the_motion_of_a_nail_is_in_the_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "trial_code", lambda *place: "code")
    results = MatrixResults(tmp_path / "matrix.jsonl")
    for world, depth in enumerate((0.0, 0.02, 0.04)):
        trial = Trial(0.0, "not-done: nail in by # mm", "f", "b", 9.0, depth)
        results.add(
            Cell("hammer", "leap_hand", "ako:published", "glove"), "code", Row({world: trial})
        )
    results.add(Cell("cube", "leap_hand", "ako:published", "glove"), "code", Row({0: DONE}))
    assert tables.mechanism_table(Outcomes(results)).rows == [["hammer", "20"]]


def test_a_file_keeps_every_trial_in_little_space_and_refuses_other_content(tmp_path):
    path = tmp_path / "matrix.jsonl"
    results = MatrixResults(path)
    cell = Cell("hammer", "leap_hand", "sbr:paper", "camera")
    trials = {
        world: Trial(0.5, f"reason {world % 3}", "dtf"[world % 3], "ntfsb"[world % 5], 3.25, 0.0123)
        for world in range(2, 100, 3)
    }
    results.add(cell, "0123456789ab", Row(trials))
    results.write()
    ((again, code), row), *others = MatrixResults(path).rows.items()
    assert (again, code, others) == (cell, "0123456789ab", [])
    assert row.trials == trials
    assert path.stat().st_size / len(trials) < 30
    path.write_text(json.dumps({"task": "cube"}) + "\n")
    with pytest.raises(DocumentError, match=r"line 1 of .*matrix\.jsonl is not a cell"):
        MatrixResults(path)


def test_a_hundred_worlds_share_the_trackers_and_unknown_names_are_errors():
    trackers = [tracker_of(world) for world in range(100)]
    assert [trackers.count(name) for name in ("glove", "headset", "camera")] == [34, 33, 33]
    assert tracker_of(7, ("camera",)) == "camera"
    for error, settings in (
        (UnknownNameError, {"tasks": ("juggle",)}),
        (UnknownNameError, {"hands": ("no_hand",)}),
        (UnknownNameError, {"trackers": ("sonar",)}),
        (ConfigError, {"worlds": 0}),
        (ConfigError, {"scaled": True, "tasks": ("cube",)}),
    ):
        with pytest.raises(error):
            MatrixSettings(**settings)


def test_the_digest_of_a_trial_follows_its_hand_and_method(monkeypatch):
    code = matrix.trial_code("cube", "leap_hand", "smooth:teleop")
    assert code == matrix.trial_code.__wrapped__("cube", "leap_hand", "smooth:teleop")
    assert code != matrix.trial_code("cube", "wuji_hand", "smooth:teleop")
    assert code != matrix.trial_code("cube", "leap_hand", "smooth:precise")
    named = []
    monkeypatch.setattr(matrix, "research_digest", lambda *names: named.append(names) or "digest")
    matrix.trial_code.__wrapped__("cube", "leap_hand", "smooth:teleop")
    matrix.trial_code.__wrapped__("cube", "leap_hand", "ako:published")
    assert ["baselines" in names for names in named] == [False, True]
    assert ["retargeting/smooth_terms.py" in names for names in named] == [True, False]
    assert not any(name.startswith("hands/models") for names in named for name in names)


def test_only_smooth_uses_the_files_that_other_methods_leave_out():
    for path in [*(HOME / "retargeting").rglob("*.py"), *(HOME / "baselines").rglob("*.py")]:
        if path.relative_to(HOME).as_posix() in matrix._SMOOTH_CODE:
            continue
        text = path.read_text(encoding="utf-8")
        for name in matrix._SMOOTH_CODE:
            assert f"retargeting.{Path(name).stem} import" not in text, path


def test_differences_are_paired_by_world_and_corrected(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "trial_code", lambda *place: "code")
    monkeypatch.setattr(tables, "label", lambda method: method)
    results = MatrixResults(tmp_path / "absent.jsonl")
    rng = np.random.default_rng(0)
    for hand in ("leap_hand", "wuji_hand"):
        for world in range(30):
            easy = rng.random() < 0.5
            for method, good in (("a:", easy), ("b:", easy), ("c:", easy and hand == "wuji_hand")):
                cell = Cell("cube", hand, method, tracker_of(world))
                results.add(cell, "code", Row({world: DONE if good else LOST}))
    outcomes = Outcomes(results)
    (row, everything) = tables.differences_table(outcomes).rows
    assert row[1] == "+0.00 [+0.00, +0.00], p = 1.000"
    assert row[2].endswith("p < 0.001") or "p = 0.00" in row[2]
    assert everything[1:] == row[1:]
    (leap, wuji) = tables.hands_table(outcomes).rows
    assert wuji[1:] == ["+0.00 [+0.00, +0.00], p = 1.000"] * 2
    assert leap[1] == wuji[1]
    assert leap[2].startswith("+0.37")
    assert "p < 0.001" in leap[2]
    values = outcomes.successes("cube", "a:")
    assert values.shape == (2, 30)
    draws = tables.bootstrap(values, 0)
    assert draws.mean() == pytest.approx(tables.mean_over_hands(values), abs=0.01)
    assert tables.two_sided(np.array([-1.0, 1.0])) == 1.0
    assert np.isnan(outcomes.successes("cube", "a:", "glove")).sum() == 0


def test_a_recording_is_one_for_all_hands_and_follows_its_tracker():
    glove, camera = (fixed_wrist.record("cube", 2, tracker) for tracker in ("glove", "camera"))
    again = fixed_wrist.record("cube", 2, "glove")
    np.testing.assert_array_equal(glove.recording.landmarks, again.recording.landmarks)
    assert len(glove.recording) == pytest.approx(96 * glove.seconds, rel=0.03)
    assert len(camera.recording) == pytest.approx(30 * camera.seconds, rel=0.03)
    np.testing.assert_array_equal(glove.world.shift, fixed_wrist.object_of(2).shift)


def test_mimics_own_demonstration_is_its_ceiling_and_a_still_hand_fails():
    block = Block("cube", "mimic_p050", CEILING, ((0, ""),))
    ((tracker, row),) = run_block(block).items()
    trial = row.trials[0]
    assert (tracker, trial.score, trial.end, trial.contact) == ("", 1.0, "s", "b")
    assert trial.reason == "done: turned by a right angle"
    hand, still = load_hand("mimic_p050"), fixed_wrist.record("cube", 0, "camera")
    joints = np.tile(hand.full_configuration(hand.neutral), (len(still.recording), 1))
    trial = judge(fixed_wrist.play(hand, replace(still, seconds=1.0), joints))
    assert (trial.score, trial.end, trial.contact) == (0.0, "f", "n")
    assert trial.reason == "not-done: turned by #°"


@pytest.mark.weekly
def test_a_block_retargets_each_recording_and_plays_it():
    block = Block("cube", "mimic_p050", "ako:published", ((0, "glove"), (1, "headset")))
    rows = run_block(block)
    assert {tracker: list(row.trials) for tracker, row in rows.items()} == {
        "glove": [0],
        "headset": [1],
    }
    assert all(row.trials[w].score == 1.0 for w, row in enumerate(rows.values()))
    watched = []
    for moments in play_block(load_hand("mimic_p050"), block, watched.append):
        next(moments)
    assert len(watched) == 2


def test_the_command_runs_a_matrix_and_fills_a_page(blocks, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = "cross-hand run --hands leap_hand,wuji_hand --tasks cube --workers 0 --quiet"
    assert main([*words.split(), "--results", "out/m.jsonl"]) == 0
    page = tmp_path / "page.md"
    later = "<!-- table: scaled-means -->\nlater\n<!-- end -->\n"  # has no trials yet
    page.write_text(f"<!-- table: success-cube -->\nold\n<!-- end -->\ntext\n{later}")
    report = "cross-hand report --results out/m.jsonl --docs page.md --plots plots"
    assert main(report.split()) == 0
    assert "| `leap_hand` | 1.00 [0.76, 1.00] | 0.00 [0.00, 0.24] |" in page.read_text()
    assert page.read_text().endswith(f"<!-- end -->\ntext\n{later}")
    assert (tmp_path / "plots" / "cross-hand.svg").stat().st_size > 1000
    assert main(["cross-hand", "report", "--results", "absent.jsonl"]) == 2
    assert "has no results yet" in capsys.readouterr().err
