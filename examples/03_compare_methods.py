"""Methods side by side: one recording, one hand, each method's preset, the same metrics."""

from smooth_operator import (
    Retargeter,
    SyntheticOperator,
    assemble_trace,
    evaluate,
    load_hand,
    method_config,
)

METHODS = {"smooth": "teleop", "sbr": "realtime", "dexpilot": "published", "joint_angle": "default"}

hand = load_hand("mimic_p050", "right")
recording = SyntheticOperator(seed=3, rate_hz=50).record(duration=1.0)

print("method       direction     motion     jitter [m^2]  self-collision [%]")
for method, preset in METHODS.items():
    config = method_config(method, preset)
    commands, _ = Retargeter(hand, config=config).run(recording)
    values = evaluate(assemble_trace(recording, commands, hand, config.alignment))
    print(
        f"{method:12}"
        f"{values['cosine_similarity']:10.3f}"  # of the thumb-to-tip vectors; 1 is best
        f"{values['motion_preservation']:11.3f}"  # of the fingertips' motion; 1 is best
        f"{values['flatness']:17.2e}"
        f"{100 * values['self_collision']['share']:20.1f}"  # of the frames
    )
