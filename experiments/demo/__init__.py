"""What ``surefoot demo`` makes."""
