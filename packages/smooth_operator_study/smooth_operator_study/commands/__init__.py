"""The command ``smooth-operator study``: its options, and the work of each subcommand."""
