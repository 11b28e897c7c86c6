"""The command ``smooth-operator study``: its options and its subcommands."""
