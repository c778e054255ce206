"""What one mission is made of: frozen, typed, validated settings with units in their names."""
