"""The method that eliminates elastic rows onto the nodes, and what it is made of."""
