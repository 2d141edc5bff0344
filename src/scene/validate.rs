//! What a scene must satisfy before anything renders it; nothing later checks again.
impl super::Scene {
    /// stub
    pub fn validate(&self) -> crate::Result<()> {
        Ok(())
    }
}
