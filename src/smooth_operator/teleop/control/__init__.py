"""What is done to a loop while it runs: another method, another operator, another task."""
