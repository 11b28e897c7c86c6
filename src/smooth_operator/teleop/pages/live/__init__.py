"""The live page: a separate process draws it, so that the loop never waits for a browser."""
