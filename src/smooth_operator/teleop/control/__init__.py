"""Control of a running loop: changes its method, operator or task."""
