"""Messages between service and clients: binary frames, posed jets, and the layout that makes vertices of them."""
