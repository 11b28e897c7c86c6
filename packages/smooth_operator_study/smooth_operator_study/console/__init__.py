"""The study in a browser: a page for the experimenter, a page for the operator's questionnaires."""
