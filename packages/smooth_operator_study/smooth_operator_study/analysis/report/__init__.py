"""Report of a study: its texts, tables and figures."""
