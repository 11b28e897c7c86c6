"""Shared parts of the web servers: authentication, page files, safe headers, addresses."""
