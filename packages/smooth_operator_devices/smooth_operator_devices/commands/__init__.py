"""The command ``smooth-operator hardware``: its options and its subcommands."""
