//! Random, cut and flipped bytes: readers give an answer or an error, never a panic, and never allocate out of
//! proportion to the file.

mod common;

use common::{OBJ, SCENE, glb, ply_ascii, ply_binary};
use proptest::prelude::*;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use umbrage_scene::{Scene, read_mesh, read_points, read_polygons};

/// Largest single allocation that reading a file of a few hundred bytes may ask for.
const MOST_BYTES: usize = 32 << 20;

struct Watched;

thread_local! {
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged; counting doesn't allocate.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = LARGEST.try_with(|l| l.set(l.get().max(layout.size())));
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise, passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let _ = LARGEST.try_with(|l| l.set(l.get().max(size)));
        // SAFETY: the caller's promise, passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

/// Reads `bytes` as each format and checks what comes back.
fn feed(extension: &str, bytes: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("a.{extension}"));
    std::fs::write(&path, bytes).unwrap();
    LARGEST.set(0);
    let mut messages = Vec::new();
    match extension {
        "toml" => messages.extend(Scene::load(&path).err().map(|e| e.to_string())),
        _ => match read_mesh(&path) {
            Ok(mesh) => mesh.validate().unwrap(),
            Err(error) => messages.push(error.to_string()),
        },
    }
    if extension == "obj" {
        messages.extend(read_polygons(&path).err().map(|e| e.to_string()));
    }
    if extension == "ply" {
        messages.extend(read_points(&path).err().map(|e| e.to_string()));
    }
    // A flipped bit in a scene may well ask for a larger mesh, which is no fault.
    if extension != "toml" {
        assert!(LARGEST.get() <= MOST_BYTES, "{} bytes", LARGEST.get());
    }
    for message in messages {
        assert!(message.starts_with(&path.display().to_string()), "{message}");
        assert!(!message.contains(|c: char| c.is_control()), "{message:?}");
        assert!(message.len() < 1000, "{message}");
    }
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

fn valid(which: usize) -> (&'static str, Vec<u8>) {
    match which {
        0 => ("obj", OBJ.into()),
        1 => ("ply", ply_ascii()),
        2 => ("ply", ply_binary(false)),
        3 => ("ply", ply_binary(true)),
        4 => ("glb", glb()),
        _ => ("toml", SCENE.into()),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn flipped_bits(
        which in 0usize..6,
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0u8..8), 1..6),
    ) {
        let (extension, mut bytes) = valid(which);
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        feed(extension, &bytes);
    }

    #[test]
    fn digits_become_other_digits(
        which in 0usize..6,
        changes in prop::collection::vec((any::<prop::sample::Index>(), 0usize..12), 1..4),
    ) {
        // Counts, offsets and types are where trust goes wrong.
        const NUMBERS: [&str; 12] =
            ["0", "1", "-1", "2", "3", "255", "5126", "65536", "4294967295", "18446744073709551615", "1e39", "nan"];
        // In a scene huge counts are orders, not lies; those are tested by their messages.
        let (extension, bytes) = valid(which % 5);
        let mut text: Vec<u8> = bytes;
        for (at, number) in changes {
            let digits: Vec<usize> = (0..text.len()).filter(|&i| text[i].is_ascii_digit()).collect();
            let start = digits[at.index(digits.len())];
            let end = (start..text.len()).find(|&i| !text[i].is_ascii_digit()).unwrap_or(text.len());
            text.splice(start..end, NUMBERS[number].bytes());
        }
        feed(extension, &text);
    }

    #[test]
    fn random_bytes(which in 0usize..6, bytes in prop::collection::vec(any::<u8>(), 0..300), keep in 0usize..80) {
        let (extension, start) = valid(which);
        feed(extension, &bytes);
        feed(extension, &[&start[..keep.min(start.len())], &bytes[..]].concat());
    }
}

#[test]
fn every_truncation() {
    for which in 0..6 {
        let (extension, bytes) = valid(which);
        for end in 0..bytes.len() {
            feed(extension, &bytes[..end]);
        }
    }
}

#[test]
fn the_valid_ones_are_valid() {
    for which in 0..6 {
        let (extension, bytes) = valid(which);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("a.{extension}"));
        std::fs::write(&path, bytes).unwrap();
        match extension {
            "toml" => assert_eq!(Scene::load(Path::new(&path)).unwrap().instances.len(), 3),
            _ => assert!(!read_mesh(&path).unwrap().triangles.is_empty()),
        }
    }
}
