"""A whole study through the console's pages, with disturbances; compares what was acknowledged.

``python tests/soak_study.py --operators 18 --disturbances 30`` does all trials of the paper's
design (three tasks, done by 12, 8 and 6 of 18 operators; other numbers in the same shares): every
key and click of both pages is made in headless Chromium. It prints a line of JSON; the exit status
is 1 if anything that was acknowledged is not stored and exported, or anything else is. A stand-in
answers for the teleoperation, without physics.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

from soak_study_browser import BrowserSoak
from soak_study_ledger import compare, expected


def main() -> int:
    """Runs it; see above."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--operators", type=int, default=18)
    parser.add_argument("--disturbances", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="where the study is to stay")
    options = parser.parse_args()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        soak = BrowserSoak(Path(name), options)
        try:
            soak.begin()
            soak.run()
        except BaseException:
            print(*soak.wrong()[:20], sep="\n", flush=True)
            raise
        finally:
            soak.close()
            if options.keep is not None:
                shutil.copytree(soak.folder, options.keep, dirs_exist_ok=True)
        wrong = [*soak.wrong(), *compare(soak.folder, soak.ledger)]
        events = soak.ledger.events()
        lines, answers = expected(events)
        figures = {
            "operators": len(soak.plan.codes) + soak.replacements, "trials": len(lines),
            "questionnaires": len(answers),
            "forms": sum(said["do"] == "form" for said in events.values()),
            "commands": len(soak.ledger.sent), "acknowledged": len(soak.ledger.acknowledged),
            "refused": dict(soak.ledger.refused),
            "disturbances": dict(soak.done), "wrong": wrong[:20], "wrong_count": len(wrong),
            "answers_that_changed": soak.ledger.changed_answers,
            "seconds": round(time.monotonic() - begin, 1),
        }  # fmt: skip
        print(json.dumps(figures), flush=True)
    return 1 if wrong or soak.ledger.changed_answers else 0


if __name__ == "__main__":
    sys.exit(main())
