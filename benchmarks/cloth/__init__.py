"""Proof of the fabrics by the tests of textile laboratories."""
