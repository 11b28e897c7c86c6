"""One human demonstration, played on every robot hand."""
