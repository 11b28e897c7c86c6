"""The command lines of the documentation."""

import re
import shlex
from collections.abc import Iterator
from typing import Final, NamedTuple

_BLOCK: Final = re.compile(r"^(?P<fence> *`{3,})bash\n(?P<code>.*?)^(?P=fence) *$", re.M | re.S)
_COMMAND: Final = re.compile(r"^.*?(?<![\w-])smooth-operator ((?:.*\\\n)*.*)$", re.M)
_SHELL: Final = {
    "$((SLURM_ARRAY_TASK_ID + 1))/64": "1/1",
    "$SLURM_CPUS_PER_TASK": "2",
}
"""What the shell of a job puts in place of an expression."""


class CommandLine(NamedTuple):
    """A command line of a page.

    Attributes:
        line: number of its first line in the page.
        words: the arguments of ``smooth-operator``.
    """

    line: int
    words: list[str]


def command_lines(text: str) -> Iterator[CommandLine]:
    """The command lines in the shell blocks of a page, in order."""
    for block in _BLOCK.finditer(text):
        for match in _COMMAND.finditer(block["code"]):
            at = block.start("code") + match.start()
            yield CommandLine(text.count("\n", 0, at) + 1, _words(match[1].replace("\\\n", " ")))


def _words(command: str) -> list[str]:
    for expression, value in _SHELL.items():
        command = command.replace(expression, value)
    if command.count('"') % 2:  # the command is all that is between two quotes
        command = command[: command.rindex('"')]
    words = shlex.split(command, comments=True)
    end = min((words.index(mark) for mark in ("&&", "|", ">") if mark in words), default=None)
    return words[:end]
