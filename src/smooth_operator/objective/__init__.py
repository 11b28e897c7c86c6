"""What a retargeter minimises: keyvectors, their targets, and Eq. (1)."""
