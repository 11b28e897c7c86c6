"""Shared parts of the web servers: authentication, files of a page, safe headers, addresses."""
