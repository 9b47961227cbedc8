"""Scans as they come: cut into sheets, thinned out, holes told from openings and closed, faults named by place."""
