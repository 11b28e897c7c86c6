"""Makes demonstrations of the tasks for robot hands, by search in physics."""
