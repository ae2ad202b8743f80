"""What people look at: tables, and the style of pictures."""
