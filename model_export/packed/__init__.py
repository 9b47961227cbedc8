"""The packed graph: what the readable one computes, arranged for speed."""
