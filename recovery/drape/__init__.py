"""From sewing pattern to draped garment: panels placed, sewn, draped and taken in, docs/explanation/recovery.md."""
