"""The real-time loop: from the newest hand frame to a safe command, on one clock."""
