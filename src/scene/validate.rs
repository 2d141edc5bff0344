//! What a scene must satisfy before anything renders it; nothing later checks again.
