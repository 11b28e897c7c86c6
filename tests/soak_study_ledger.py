"""What pages of a study asked for and were told, and whether just that is stored and exported."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from study_console import ratings

from smooth_operator.study.console.commands import EVENTS
from smooth_operator.study.store.study_store import open_study


@dataclass
class Ledger:
    """What pages asked for, and what was acknowledged to them."""

    sent: dict[str, dict[str, Any]] = field(default_factory=dict)
    acknowledged: dict[str, int] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)
    changed_answers: int = 0
    intended: Counter[str] = field(default_factory=Counter)

    def mean(self, do: str, operator: str, fields: Mapping[str, Any]) -> None:
        """What a page is about to be made to ask for."""
        self.intended[_key(do, operator, fields)] += 1

    def surprises(self) -> list[str]:
        """What pages asked for and were not made to, or the other way round."""
        asked = Counter(
            _key(one["do"], one["operator"], one["fields"]) for one in self.sent.values()
        )
        return [
            f"asked for, and not meant: {key}" for key in (asked - self.intended).elements()
        ] + [f"meant, and not asked for: {key}" for key in (self.intended - asked).elements()]

    def scores(self) -> list[str]:
        """Tokens of the scores that were acknowledged."""
        return [token for token in self.acknowledged if self.sent[token]["do"] == "score"]

    def asked(self, said: dict[str, Any]) -> None:
        if said.get("type") == "command":
            self.sent.setdefault(said["token"], said)

    def heard(self, said: dict[str, Any]) -> None:
        token = said.get("token")
        if said["type"] == "done" and token in self.sent:
            number = said["number"]
            self.changed_answers += self.acknowledged.setdefault(token, number) != number
        elif said["type"] == "refused" and not said.get("again"):
            why = re.sub(r"\d+", "#", str(said.get("error")))[:90]
            self.refused[f"{self.sent.get(token, {}).get('do')}: {why}"] += 1

    def events(self) -> dict[tuple[str, int], dict[str, Any]]:
        """(operator, number) -> the command that was acknowledged to have written it."""
        found = {}
        for token, number in self.acknowledged.items():
            said = self.sent[token]
            if said["do"] in EVENTS:
                found[said["operator"], number] = {**said, "token": token}
        return found


def _key(do: str, operator: str, fields: Mapping[str, Any]) -> str:
    known = {name: fields[name] for name in sorted(fields) if name not in ("number", "point")}
    return f"{do} of {operator}: {json.dumps(known, sort_keys=True)}"


def expected(
    events: dict[tuple[str, int], dict[str, Any]],
) -> tuple[dict[Any, Any], dict[Any, Any]]:
    """Lines of trials and answers of questionnaires that count, from what was acknowledged."""
    undone = {
        (who, said["fields"]["number"]) for (who, _), said in events.items() if said["do"] == "undo"
    }
    lines: dict[Any, Any] = {}
    answers: dict[Any, Any] = {}
    for (who, number), said in sorted(events.items()):
        if (who, number) in undone:
            continue
        given = said["fields"]
        place = (who, given.get("task"), given.get("block"))
        if said["do"] == "score" or (said["do"] == "amend" and given.get("line")):
            lines[*place, given["trial"]] = given["line"]
        elif said["do"] == "answer":
            answers[*place, given["point"]] = given["ratings"]
    return lines, answers


def expected_forms(events: dict[tuple[str, int], dict[str, Any]]) -> dict[Any, Any]:
    """(operator, form) -> answers that were acknowledged and not undone."""
    undone = {
        (who, said["fields"]["number"]) for (who, _), said in events.items() if said["do"] == "undo"
    }
    found = {}
    for place, said in sorted(events.items()):
        given = said["fields"]
        if place not in undone and said["do"] == "form":
            found[place[0], given["form"]] = given["answers"]
    return found


def _exported_forms(data: Path) -> dict[Any, Any]:
    operators = json.loads((data / "study.json").read_text("utf-8"))["operators"]
    return {
        (one["operator"], name): form["answers"]
        for one in operators
        for name, form in one["forms"].items()
    }


def compare(folder: Path, ledger: Ledger) -> list[str]:
    """What is stored or exported and was not acknowledged, or the other way round."""
    wrong: list[str] = []
    events, data = ledger.events(), folder.parent / "data"
    subprocess.run(
        [sys.executable, "-m", "smooth_operator", "study", "export", str(folder), "--output",
         str(data)], check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    stored: dict[tuple[str, int], Any] = {}
    with open_study(folder) as store:
        for code in store.plan.codes:
            progress = store.progress(code)
            if progress.step.what not in ("done", "withdrawn") and progress.withdrawn is None:
                wrong.append(f"{code} is not done: {progress.step}")
            for record in progress.records:
                if record.author != "system" and record.event.kind in EVENTS.values():
                    stored[code, record.number] = record.event
        for place, said in events.items():
            if place not in stored:
                wrong.append(f"{place} was acknowledged and is not stored: {said}")
                continue
            known = store.recorded(said["token"])
            if known is None or (known[0], known[1].number) != place:
                wrong.append(f"{place}: the token is that of {known}")
            event = stored[place]
            if event.kind != EVENTS[said["do"]]:
                wrong.append(f"{place}: {said['do']} was stored as {event.kind}")
            for name, value in said["fields"].items():
                kept = getattr(event, name, value)
                if kept != value and list(kept) != list(value):
                    wrong.append(f"{place}: {name} {value!r} was stored as {kept!r}")
    wrong += [f"{place} is stored and was not acknowledged" for place in stored.keys() - events]
    lines, answers = expected(events)
    wrong += _differences("forms of study.json", _exported_forms(data), expected_forms(events))
    with (data / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    exported = {
        (r["operator"], r["task"], int(r["block"]), int(r["trial_in_block"])): r["line"]
        for r in rows
    }
    wrong += [f"trials.csv has {len(rows)} rows of {len(exported)} trials"] * (
        len(rows) != len(exported)
    )
    wrong += _differences("trials.csv", exported, lines)
    with (data / "tlx.csv").open(encoding="utf-8", newline="") as file:
        found = {
            (r["operator"], r["task"], int(r["block"]), r["point"]): {
                name: int(r[name]) for name in ratings(0)
            }
            for r in csv.DictReader(file)
        }
    wrong += _differences("tlx.csv", found, answers)
    everything = json.loads((data / "study.json").read_text("utf-8"))
    in_json = {
        (r["operator"], r["task"], r["block"], r["trial_in_block"]): r["line"]
        for r in everything["trials"]
    }
    wrong += _differences("study.json", in_json, lines)
    return wrong


def _differences(name: str, found: dict[Any, Any], wanted: dict[Any, Any]) -> list[str]:
    return [
        f"{name}: {key} is {found.get(key)!r}, acknowledged was {wanted.get(key)!r}"
        for key in sorted(found.keys() | wanted.keys())
        if found.get(key) != wanted.get(key)
    ]
