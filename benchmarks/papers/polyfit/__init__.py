"""PolyFit: the orientation of a patch, learned so that a jet fits it best (OneFit, section 3.1, appendix A.1)."""
