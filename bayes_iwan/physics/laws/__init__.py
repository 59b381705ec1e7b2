"""The specimen's laws: slip forces, normal force, stiffness, and how they may bend."""
