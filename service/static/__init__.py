"""A folder that drapes a garment in the browser, without a service: what it holds, and the command that writes it."""
