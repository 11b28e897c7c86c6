"""The real-time loop, which turns the newest hand frame into a safe command."""
