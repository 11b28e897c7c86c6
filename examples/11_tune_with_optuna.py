"""Search settings of a method with Optuna, on one recording, and judge them on another.

Install it with ``pip install optuna``. A search of your own takes some hundred trials.
"""

from dataclasses import replace
from pathlib import Path

import optuna

from smooth_operator import (
    HandRecording,
    Retargeter,
    SyntheticOperator,
    assemble_trace,
    evaluate,
    load_hand,
    method_config,
)

hand = load_hand("mimic_p050")
base = method_config("sbr")
train = SyntheticOperator(seed=1, rate_hz=30).record(duration=1.0)
held_out = SyntheticOperator(seed=2, rate_hz=30).record(duration=1.0)


def error(recording: HandRecording, pose_weight: float, velocity_weight: float) -> float:
    """The lack of cosine similarity and of motion preservation; a perfect method has 0."""
    objective = replace(base.objective, pose_weight=pose_weight, velocity_weight=velocity_weight)
    retargeter = Retargeter(hand, config=replace(base, objective=objective))
    commands, _ = retargeter.run(recording)
    values = evaluate(assemble_trace(recording, commands, hand))
    return 2.0 - values["cosine_similarity"] - values["motion_preservation"]


def trial(study_trial: optuna.Trial) -> float:
    return error(
        train,
        study_trial.suggest_float("pose_weight", 0.01, 0.1, log=True),
        study_trial.suggest_float("velocity_weight", 0.02, 0.5, log=True),
    )


start = {name: getattr(base.objective, name) for name in ("pose_weight", "velocity_weight")}
study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
study.enqueue_trial(start)
study.optimize(trial, n_trials=3)
before, now = error(held_out, **start), error(held_out, **study.best_params)
print(f"held out: {before:.4f} before, {now:.4f} now")

# A preset file: smooth-operator retarget glove.npz --method sbr --preset tuned.toml
rows = [f'"objective.{name}" = {value!r}' for name, value in study.best_params.items()]
Path("tuned.toml").write_text(
    "\n".join(['format = 1\nmethod = "sbr"\nbase = "realtime"\n\n[settings]', *rows, ""])
)
assert method_config("sbr", "tuned.toml").objective.pose_weight == study.best_params["pose_weight"]
