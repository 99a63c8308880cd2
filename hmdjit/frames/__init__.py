"""What passes from stage to stage: motion, displacements, frames, and what is read."""
