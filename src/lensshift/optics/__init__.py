"""The movable lens: what it images, how sharply, and how far the image moves with an element."""
