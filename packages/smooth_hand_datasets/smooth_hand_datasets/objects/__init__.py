"""Retargeting with objects: contacts of the human hand are kept, penetration is priced."""
