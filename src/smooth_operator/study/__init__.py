"""User studies of retargeters: data, analysis, report."""
