"""The live page. A separate process draws it, so that the loop never waits for a browser."""
