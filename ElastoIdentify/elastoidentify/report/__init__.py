"""What people read: tables, pictures, lines on a terminal."""
