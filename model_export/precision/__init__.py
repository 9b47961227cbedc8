"""The packed graph in fewer bits: int8 for processors, float16 for GPUs."""
