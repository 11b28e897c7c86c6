"""A study done by virtual operators in physics, trial by trial; no study with people."""
