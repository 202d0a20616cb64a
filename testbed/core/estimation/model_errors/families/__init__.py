"""Families of model errors, one file each."""
