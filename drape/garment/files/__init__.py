"""Readers of garment files, one per format of ``drape.files.formats``."""
