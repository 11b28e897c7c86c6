"""Control of a running loop: another method, operator or task."""
