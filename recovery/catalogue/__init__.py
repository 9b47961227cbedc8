"""The catalogue's garments: sewn from patterns of our own, at rest on the standard body, docs/guide/catalogue.md."""
