"""A format of data sets: the joints [rad] of each clip as a table."""

import os

import numpy as np


class CsvFormat:
    what = "a folder of CSV tables"
    loses = "It holds the joints alone."

    def open(self, output, options):
        output.mkdir(parents=True, exist_ok=True)
        return CsvWriter(output)


class CsvWriter:
    """Each table is whole or not there, so that a run that was stopped goes on after the last."""

    def __init__(self, output):
        self.output = output
        self.notes = []
        self.written = {path.stem for path in output.glob("*.csv")}

    def write(self, clip):
        if clip.key in self.written:
            return
        names, columns = ["stamp"], [clip.clip.stamps[:, None]]
        for side, commands in clip.commands.items():
            names += [f"{side}.{name}" for name in commands.joint_names]
            columns.append(commands.joint_positions)
        path = self.output / f"{clip.key}.csv"
        unfinished = path.with_suffix(".tmp")
        table = np.concatenate(columns, axis=1)
        np.savetxt(unfinished, table, delimiter=",", header=",".join(names), comments="")
        os.replace(unfinished, path)

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


CSV = CsvFormat()
