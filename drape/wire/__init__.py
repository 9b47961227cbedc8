"""What goes over the line: binary messages, posed jets, and what makes vertices of them."""
