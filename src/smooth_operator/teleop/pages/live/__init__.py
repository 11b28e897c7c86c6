"""The live page: a process of its own draws it, so that the loop never waits for a browser."""
