"""Files of a study that are damaged: each is read soundly or refused in one sentence."""

import sys
from pathlib import Path

import fuzzing
import hostile_files
import pytest
import study_files

from smooth_operator.errors import StudyError
from smooth_operator_study.data.reading import read_study


@pytest.mark.skipif(sys.platform != "linux", reason="limits and peaks are Linux's")
def test_mutants_are_read_soundly_or_refused(tmp_path):
    places = [str(Path(module.__file__).parent) for module in (study_files, hostile_files)]
    with fuzzing.ReaderProcess(places) as process:
        seeds = study_files.seeds()
        tally = hostile_files.read_mutants(process, "study_files", seeds, tmp_path, tries=32)
    for name, counts in tally.items():
        assert counts["refused"], (name, counts)


@pytest.mark.parametrize("text", ["1_0", "٣", "0x1", "1e400", "9" * 400, "inf"])
def test_what_python_takes_for_a_number_is_none_in_a_table(tmp_path, text):
    rows = study_files.TRIALS.replace("P0,A,sbr,1,", f"P0,A,sbr,{text},")
    (tmp_path / "trials.csv").write_text(rows, encoding="utf-8")
    with pytest.raises(StudyError, match="expected a whole number of at least 1"):
        read_study([tmp_path / "trials.csv"])
