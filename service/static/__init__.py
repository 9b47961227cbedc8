"""Writes a folder of files by which browsers drape a garment without a service."""
