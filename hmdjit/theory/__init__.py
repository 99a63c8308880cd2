"""What flicker should be, from head paths and a picture's statistics alone."""
