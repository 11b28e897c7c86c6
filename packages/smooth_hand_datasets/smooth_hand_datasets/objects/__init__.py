"""Retargeting with objects: keeps contacts of the human hand and penalises penetration."""
