"""Design of a study: protocol, balanced orders of conditions and tasks, plan files."""
