"""What meets the water: screws and hull."""
