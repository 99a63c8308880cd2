"""What flicker should be, from head paths and a picture's statistics alone.

Studies with a tolerance use these predictions as control variates.
"""
