"""Drivers of real robot hands, one file each."""
