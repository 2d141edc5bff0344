//! Scenes made in memory.
