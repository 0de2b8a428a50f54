//! Ray casters of others that suites measure ours against.

use crate::entry::Entry;
use anyhow::Result;
use clap::ValueEnum;
use umbrage_geom::{OpticalDepth, Ray, TriangleMesh};

/// What `--peer` may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PeerName {
    /// Embree 3, from the system's libembree3.
    Embree,
}

/// Time and memory of a peer's two builds, on one thread.
#[derive(Clone, Copy, Debug)]
pub struct Builds {
    pub high_s: f64,
    pub medium_s: f64,
    pub high_bytes: usize,
    pub medium_bytes: usize,
}

/// A peer that has built its structures over one mesh.
pub trait Peer {
    /// Method and baseline name in rows.
    fn name(&self) -> &'static str;

    fn builds(&self) -> Builds;

    /// Every way to ask for any hit; the fastest counts.
    fn any_hit<'a>(&'a self, rays: &'a [Ray]) -> Vec<Box<dyn Entry<bool> + 'a>>;

    /// Every way to ask for any hit of a front, counter-clockwise corners: rays pass through backs.
    ///
    /// # Errors
    /// What the peer reports if it has to build for it.
    fn front_hit<'a>(&'a self, rays: &'a [Ray]) -> Result<Vec<Box<dyn Entry<bool> + 'a>>>;

    /// Every way to dim rays by `opacity` for each triangle hit.
    fn transmittance<'a>(
        &'a self,
        rays: &'a [Ray],
        opacity: OpticalDepth,
    ) -> Vec<Box<dyn Entry<OpticalDepth> + 'a>>;
}

/// Builds the peer's structures.
///
/// # Errors
/// If the peer was not built in, or what it reports.
#[cfg(feature = "embree")]
pub fn open(name: PeerName, mesh: &TriangleMesh) -> Result<Box<dyn Peer>> {
    match name {
        PeerName::Embree => Ok(Box::new(crate::embree::Embree::new(mesh)?)),
    }
}

/// Builds the peer's structures.
///
/// # Errors
/// Always: no peer was built in.
#[cfg(not(feature = "embree"))]
pub fn open(name: PeerName, _mesh: &TriangleMesh) -> Result<Box<dyn Peer>> {
    match name {
        PeerName::Embree => Err(missing()),
    }
}

/// Says how to get the peer.
#[cfg(not(feature = "embree"))]
pub fn missing() -> anyhow::Error {
    anyhow::anyhow!(
        "built without Embree: use `cargo xtask bench SUITE --peer embree`, or `--features embree`; \
         `cargo xtask peers` says how to install it"
    )
}
