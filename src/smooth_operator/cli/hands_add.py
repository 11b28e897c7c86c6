"""``smooth-operator hands add``: turns a hand model into a spec file and prints a checklist."""

from __future__ import annotations

import contextlib
import json
import re
import sys
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from tyro.conf import Positional, UseAppendAction, arg

from smooth_operator.cli.common_options import Common, HandSide, Page
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.terminal import print_note

if TYPE_CHECKING:
    from smooth_operator.hand_discovery.landmarks import Discovery, Overrules
    from smooth_operator.hand_discovery.loops import OpenModel
    from smooth_operator.hands.hand import Hand
    from smooth_operator.hands.spec import Coupling, HandSpec, Point


_NUMBER: Final = r"-?\d+\.?\d*(?:[eE][+-]?\d+)?"


@dataclass(frozen=True, kw_only=True)
class Add(Common, Page):
    """Add your own hand: analyse a URDF or MJCF model and write a spec file."""

    work: ClassVar[str] = "smooth_operator.cli.hands_add:add_hand"
    details: ClassVar[str] = """Finds the palm, the fingers and their order, the thumb, fingertips,
side, coupled joints, wrist and a neutral pose from the motion of the joints, not from their names.
The output lists the uncertain findings, each with the option that overrides it; run the command
again with those options. If side, palm, thumb, order or wrist would be a guess, the command asks
for the option and writes nothing. --all prints every finding with its reason; the spec file also
has them as comments. The model and its meshes are copied to the folder of the spec file, so you may
move or delete the original. If you change the original, run the command again.

Examples:
  smooth-operator hands add vendor/hand_right.urdf
  smooth-operator hands add two_hands.urdf --side left --name my_left
  smooth-operator hands add hand.xml --thumb link_12 --tip index=link_3:0,0,0.027 --overwrite
  smooth-operator hands add so101.urdf --gripper gripper
  smooth-operator hands add robot_descriptions:allegro_hand --side right
  smooth-operator hands add revo3 --from brainco-description --side left
  smooth-operator hands add hand.urdf --json"""

    model: Annotated[Positional[Path], arg(metavar="PATH|robot_descriptions:NAME|NAME")]
    """URDF or MJCF file, with or without meshes; it may include an arm. Or robot_descriptions:NAME,
    a model from the Python package robot_descriptions. Or the name of a hand whose model is in its
    maker's repository (see hands list)."""

    from_: Annotated[Path | None, arg(name="from", metavar="FOLDER")] = None
    """Your clone of the maker's repository, if NAME is a hand whose model is not included."""

    name: Annotated[str | None, arg(metavar="NAME")] = None
    """Name of the hand, for --hand. Default: the name of the file."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Selects one hand if the file contains two. Default: detected in the model."""

    gripper: Annotated[str | None, arg(metavar="JOINT")] = None
    """Joint of a gripper's jaw. The other jaw, which may be fixed, becomes the thumb."""

    palm: Annotated[str | None, arg(metavar="BODY")] = None
    """Body from which the fingers branch."""

    thumb: Annotated[str | None, arg(metavar="BODY")] = None
    """A body or joint of the thumb."""

    finger: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FINGER=BODY")] = ()
    """FINGER is the human finger that drives the robot finger; BODY is a body or joint of the
    robot finger. Use it also for a chain that was not detected as a finger."""

    tip: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FINGER=BODY:x,y,z")] = ()
    """Fingertip: the last body of the finger, and a point in that body's frame [m]."""

    wrist: Annotated[str | None, arg(metavar="BODY:x,y,z")] = None
    """Wrist: a body fixed to the palm, and a point in its frame [m]."""

    couple: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="JOINT=LEADER*A+B")] = ()
    """Joint without a motor, and the joint that it follows: index_dip=index_pip*0.89+0.1 [rad]. Or
    give the coefficients of a polynomial, constant first: index_dip=index_pip:0,0.7,0.2."""

    overwrite: bool = False
    """Replace an existing spec file of that name and side."""

    in_place: bool = False
    """Do not copy the model: the spec file refers to the original. A model with closed loops is
    always copied, because the loops are removed in the copy."""

    json: bool = False
    """Print one JSON object on standard output instead of the checklist; do not serve a page."""

    all: bool = False
    """Print all findings with their reasons."""

    view: bool = False
    """Serve a page that shows the hand, until Ctrl-C."""


def add_hand(options: Add) -> None:
    """Analyses a model, prints the findings, writes the spec file and opens the page that shows the
    hand."""
    from smooth_operator.hand_discovery.loops import opened
    from smooth_operator.hand_files.robot_descriptions import PREFIX, description_file
    from smooth_operator.hands.registry import MAKERS_HANDS
    from smooth_operator.hands.spec_file import check_hand_name

    if options.name is not None:
        check_hand_name(options.name)
    if str(options.model) in MAKERS_HANDS and not options.model.is_file():
        options = _of_maker(options)
    elif options.from_ is not None:
        raise ConfigError(
            "--from is for hands whose models are in their makers' repositories "
            f"({', '.join(MAKERS_HANDS)}), not for {options.model}; leave it out"
        )
    if str(options.model).startswith(PREFIX):
        file = description_file(str(options.model).removeprefix(PREFIX))
        options = replace(options, model=file)
    with opened(options.model) as model:
        _add_hand(options, model)


def _of_maker(options: Add) -> Add:
    """Options for a hand whose model is in a clone; those that the user gave have precedence."""
    from smooth_operator.hand_files.makers_hands import makers_hand

    hand = makers_hand(str(options.model), options.side or "right")
    file = hand.find(options.from_)
    if not hand.was_checked(file):
        print_note(
            f"smooth-operator: warning: {file} differs from the model that was checked (commit "
            f"{hand.commit}); check the result with smooth-operator hands check"
        )
    missing: dict[str, Any] = {
        option: tuple(value) if isinstance(value, list) else value
        for option, value in hand.options.items()
        if not getattr(options, option)
    }
    return replace(options, model=file, side=hand.side, name=options.name or hand.name, **missing)


def _add_hand(options: Add, model: OpenModel) -> None:
    from smooth_operator.hand_discovery.discover import discover, hand_name
    from smooth_operator.hand_files.user_hands import save_hand, spec_name
    from smooth_operator.hands.loading import merged_couplings
    from smooth_operator.hands.registry import user_hands_folder
    from smooth_operator.hands.spec_file import read_hand_spec

    overrules, changed = _overrules(options), model.path != options.model
    if changed:
        couplings = merged_couplings(model.couplings, overrules.couplings)
        overrules = replace(overrules, couplings=couplings)
    discovery = discover(
        model.path,
        side=options.side,
        name=options.name or hand_name(options.model),
        overrules=overrules,
    )
    _refuse_guesses(discovery, options)
    hand, notes = _trial(discovery.spec)
    twin = None if hand is None else _built_in(hand)
    spec = discovery.spec if hand is None or twin is None else _mapped(hand, twin)
    notes = (*model.notes, *discovery.notes, *notes)
    discovery = replace(discovery, spec=_named(spec, options), notes=notes)
    file = user_hands_folder() / spec_name(discovery.spec.name, discovery.spec.side)
    if not options.overwrite and file.exists() and not _same(file, discovery.spec):
        raise ConfigError(
            f"there is already a {discovery.spec.side} hand {discovery.spec.name!r}, in "
            f"{file}: use --overwrite to replace it, or --name to choose another name"
        )
    save_hand(discovery.spec, comment=_comment(discovery), copy=changed or not options.in_place)
    used = read_hand_spec(file).model
    if changed:
        discovery = replace(discovery, spec=replace(discovery.spec, model=options.model.absolute()))
    if options.json:
        files = {"file": str(file), "model_used": str(used)}
        print(json.dumps(discovery.to_json() | files, indent=2))
        return
    _print(discovery, file, used, twin, options.all)
    if options.view:
        from smooth_operator.cli.hands_show import Show, show_hand

        show_hand(
            Show(
                hand=str(file),
                debug=options.debug,
                host=options.host,
                port=options.port,
                no_browser=options.no_browser,
            )
        )


def _refuse_guesses(discovery: Discovery, options: Add) -> None:
    """Stops at a property that is only guessed, unless the user has set it."""
    fingers = options.finger or None
    given = {
        "side": options.side,
        "palm": options.palm or options.gripper,
        "thumb": options.thumb or fingers,
        "order": fingers,
        "wrist": options.wrist,
    }
    guesses = [guess for guess in discovery.guesses if given[guess.subject] is None]
    if guesses:
        options_of = {"side": "--side right|left"}
        texts = [
            f"the {guess.subject} is only a guess ({guess.value}, confidence "
            f"{guess.confidence:.2f}: {'; '.join(guess.evidence)}); set it with "
            f"{options_of.get(guess.subject, guess.overrule)}"
            for guess in guesses
        ]
        raise ConfigError(f"{options.model}: {'. '.join(texts)}")


def _overrules(options: Add) -> Overrules:
    from smooth_operator.hand_discovery.landmarks import Overrules

    fingers = tuple(_pair(text, "--finger", "FINGER=BODY") for text in options.finger)
    tips = []
    for text in options.tip:
        finger, place = _pair(text, "--tip", "FINGER=BODY:x,y,z")
        tips.append((finger, _point(place, f"--tip {text}")))
    wrist = None if options.wrist is None else _point(options.wrist, f"--wrist {options.wrist}")
    return Overrules(
        palm=options.palm,
        thumb=options.thumb,
        fingers=fingers,
        tips=tuple(tips),
        wrist=wrist,
        couplings=tuple(map(_coupling, options.couple)),
        gripper=options.gripper,
    )


def _coupling(text: str) -> Coupling:
    from smooth_operator.hands.spec import Coupling

    joint, rest = _pair(text, "--couple", "JOINT=LEADER*A+B")
    leader, sign, numbers = rest.rpartition(":")
    if sign and re.fullmatch(rf"{_NUMBER}(,{_NUMBER})+", numbers):
        return Coupling.of(joint, leader, [float(number) for number in numbers.split(",")])
    match = re.fullmatch(rf"(.+?)(?:\*({_NUMBER})([+-]{_NUMBER})?)?", rest)
    assert match is not None  # the leader's name takes what is no number
    leader, factor, offset = match.groups()
    return Coupling(joint, leader, float(factor or 1.0), float(offset or 0.0))


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, sign, rest = text.partition("=")
    if not (name and sign and rest):
        raise ConfigError(f"{option} {text}: expected {form}, such as index=link_3")
    return name, rest


def _point(text: str, option: str) -> Point:
    # A body's name may contain a colon; numbers never do.
    from smooth_operator.hands.spec import Point

    body, sign, numbers = text.rpartition(":")
    if not sign:
        return Point(text)
    try:
        x, y, z = (float(number) for number in numbers.split(","))
    except ValueError:
        raise ConfigError(
            f"{option}: expected BODY:x,y,z with three numbers in metres, not {numbers!r}"
        ) from None
    if not body or max(abs(x), abs(y), abs(z)) > 1:
        raise ConfigError(f"{option}: expected BODY:x,y,z in metres, less than 1 m from the body")
    return Point(body, (x, y, z))


def _named(spec: HandSpec, options: Add) -> HandSpec:
    """Picks a name that no hand has yet, unless the user gave one: an existing hand is never
    replaced without --overwrite."""
    from smooth_operator.hand_files.user_hands import spec_name
    from smooth_operator.hands.registry import known_hands, user_hands_folder

    if options.name is not None:
        return spec
    builtin = {entry.name for entry in known_hands().values() if entry.builtin}
    base = f"my_{spec.name}" if spec.name in builtin else spec.name
    for name in (base if k == 1 else f"{base}_{k}" for k in count(1)):
        file = user_hands_folder() / spec_name(name, spec.side)
        named = replace(spec, name=name)
        if options.overwrite or not file.exists() or _same(file, named):
            return named
    raise AssertionError  # the search always finds a free name


def _same(file: Path, spec: HandSpec) -> bool:
    """True if a spec file has the same description, so that overwriting it loses nothing."""
    from smooth_operator.hands.spec_file import read_hand_spec

    try:
        there = read_hand_spec(file)
        same_model = there.model == spec.model or (
            there.model.read_bytes() == spec.model.read_bytes()
        )
    except (SmoothOperatorError, OSError):
        return False
    return same_model and replace(there, model=spec.model) == spec


def _trial(spec: HandSpec) -> tuple[Hand | None, tuple[str, ...]]:
    """Loads the hand and returns it, None if it can't be loaded, with notes on missing parts."""
    from smooth_operator.hands.hand import load_hand_spec
    from smooth_operator.hands.stand_ins import stand_in_note

    try:
        hand = load_hand_spec(spec)
    except SmoothOperatorError as error:
        return None, (f"the spec file is written, but can't be loaded yet: {error}",)
    return hand, tuple(filter(None, [stand_in_note(hand), _motors_note(hand), _leader_note(hand)]))


def _leader_note(hand: Hand) -> str | None:
    """Note on a joint beyond the second of its finger that follows a joint of another finger."""
    from smooth_operator.hand_discovery.checks import movers

    chains = {
        finger: [hand.joint_names[j] for j in movers(hand, tip)]
        for finger, tip in zip(hand.fingers, hand.tip_names, strict=True)
    }
    for c in () if hand.spec.gripper else hand.couplings:
        own = {name for name, chain in chains.items() if c.joint in chain[2:]}
        other = {name for name, chain in chains.items() if c.follows in chain}
        if own and other and not own & other:
            return (
                f"in the file, {c.joint} of the {min(own)} finger follows {c.follows} of the "
                f"{min(other)} finger: check that, and correct it with --couple"
            )
    return None


def _motors_note(hand: Hand) -> str | None:
    """Note on a model without couplings: a URDF without mimic names no motors, and simulators
    often give each joint a motor of its own."""
    if hand.couplings or len(hand.actuated) == 1:
        return None
    return (
        f"the model has {len(hand.actuated)} joints and no couplings: check how many motors the "
        "maker specifies. If there are fewer, use --couple to set which joints follow another one"
    )


def _comment(discovery: Discovery) -> str:
    lines = ["Written by smooth-operator hands add. Findings and their confidence (0 to 1):"]
    for finding in discovery.findings:
        lines.append(f"{finding.confidence:.2f}  {finding.subject}: {finding.value}")
        lines += [f"        {reason}" for reason in finding.evidence]
    return "\n".join([*lines, *(f"Note: {note}" for note in discovery.notes), ""])


def _built_in(hand: Hand) -> str | None:
    """Returns the built-in hand with the same joints, or None.

    The catalogue uses the joint names of the vendor's URDF, so names can be compared. A hand of the
    other side has other prefixes and does not match.
    """
    from smooth_operator.hands.registry import known_hands, load_hand

    joints, side = set(hand.joint_names), hand.spec.side
    for name, entry in known_hands().items():
        with contextlib.suppress(SmoothOperatorError):
            if entry.builtin and joints == set(load_hand(name, side).joint_names):
                return name
    return None


def _mapped(hand: Hand, twin: str) -> HandSpec:
    """Returns the description with the joint map of the built-in hand with the same joints, if that
    map gives better thumb directions than the measured map."""
    from smooth_operator.hand_discovery.joint_map import mapped_thumb_error
    from smooth_operator.hands.hand import load_hand_spec
    from smooth_operator.hands.registry import load_hand

    spec = hand.spec
    mapped = replace(spec, joint_map=load_hand(twin, spec.side).spec.joint_map)
    own, theirs = (mapped_thumb_error(one) for one in (hand, load_hand_spec(mapped)))
    return mapped if theirs is not None and (own is None or theirs < own) else spec


def _print(discovery: Discovery, file: Path, used: Path, twin: str | None, whole: bool) -> None:
    from rich.text import Text

    from smooth_operator.cli.console import output_console, plain_table

    console = output_console()
    table = plain_table(f"{discovery.spec.name}, from {discovery.spec.model}")
    for header in ("", "what", "found", "sure", "because"):
        table.add_column(header, no_wrap=header in ("", "what", "sure"))
    shown = discovery.findings if whole else discovery.unsure
    for finding in shown:
        mark, style = _mark(finding.confidence)
        table.add_row(
            Text(mark, style),
            finding.subject,
            Text(finding.value),
            f"{finding.confidence:.2f}",
            Text("; ".join(finding.evidence)),
        )

    def say(text: str) -> None:
        console.print(text, markup=False, soft_wrap=True)

    if shown:
        console.print(table)
    if not whole:
        sure, total = len(discovery.findings) - len(shown), len(discovery.findings)
        say(
            f"{sure} of {total} properties of {discovery.spec.name} were detected with confidence "
            "(--all lists them)"
        )
    for note in discovery.notes:
        say(f"Note: {note}")
    if discovery.unsure:
        say(
            "Check the items marked ? or !, which are listed least certain first. To override "
            "one, add:"
        )
        for finding in discovery.unsure:
            say(f"  {finding.subject} ({finding.confidence:.2f}): {finding.overrule}")
    else:
        say(
            "To override a property, use --side, --palm, --thumb, --finger, --tip, --wrist, "
            "--couple"
        )
    if used != discovery.spec.model:
        say(
            f"Copied the model and the files that it uses to {used.parent}. You may move or "
            "delete the original. If you change the original, add the hand again"
        )
    say(f"Written to {file}; you may edit this file")
    if twin is not None:
        say(
            f"The built-in hand {twin} has the same joints; you can use it without a file of "
            f"your own: --hand {twin}"
        )
    say(f"Next: smooth-operator hands check {discovery.spec.name} --side {discovery.spec.side}")
    sys.stdout.flush()


def _mark(confidence: float) -> tuple[str, str]:
    from smooth_operator.hand_discovery.landmarks import SURE, UNSURE

    if confidence >= SURE:
        return "✓", "green"
    return ("?", "yellow") if confidence >= UNSURE else ("!", "red")
