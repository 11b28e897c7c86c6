"""Settings of a process for compiled programs, and retargeters built with them."""
