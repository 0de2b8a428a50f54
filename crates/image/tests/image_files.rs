//! Image files: what is written is read back, bytes don't vary, failures destroy nothing.

use std::{
    fs,
    path::{Path, PathBuf},
};
use umbrage_image::*;

/// All layers of a rendering, with the values that files tend to lose.
fn film(width: u32, height: u32) -> Film {
    let mut film = Film::new(width, height).unwrap();
    let layers =
        [("cost", GREY), ("beauty", RGB), ("depth", Z), ("normal", XYZ), ("shadow", RGB), ("ao", GREY)];
    for (i, (name, channels)) in layers.into_iter().enumerate() {
        for (j, value) in film.add_layer(name, channels).unwrap().values_mut().iter_mut().enumerate() {
            *value = ((j * 7919 + i * 104_729) % 1009) as f32 / 1009.0;
        }
    }
    let odd = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, 1e-30];
    film.layer_mut("depth").unwrap().values_mut()[..odd.len()].copy_from_slice(&odd);
    film
}

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn exr_keeps_every_bit_and_layer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.EXR");
    let film = film(37, 29);
    write(&path, &film, 0.0).unwrap();
    let back = read(&path).unwrap();
    assert!(back.same_bits(&film));
    assert_eq!(back.layers().iter().map(Layer::name).collect::<Vec<_>>(), names::ALL);
    assert_eq!(back.layer("beauty").unwrap().channels(), RGB);
    assert_eq!(back.layer("normal").unwrap().channels(), XYZ);
    assert_eq!(names_in(folder.path()), ["a.EXR"]);
}

#[test]
fn exr_bytes_depend_on_nothing_else() {
    let film = film(64, 100);
    let bytes = encode_exr(&film).unwrap();
    assert!((0..4).all(|_| encode_exr(&film).unwrap() == bytes));
    let mut reordered = Film::new(64, 100).unwrap();
    for layer in film.layers().iter().rev() {
        let channels: Vec<&str> = layer.channels().iter().map(String::as_str).collect();
        reordered.add_layer_with(layer.name(), &channels, layer.values().to_vec()).unwrap();
    }
    assert!(encode_exr(&reordered).unwrap() == bytes);
    assert!(encode_exr(&Film::new(1, 1).unwrap()).is_err());
}

#[test]
fn other_programs_find_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &film(20, 10)).unwrap();
    let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
    let names: Vec<String> =
        meta.headers[0].channels.list.iter().map(|channel| channel.name.to_string()).collect();
    let expected = "B G R Z ao.Y cost.Y normal.X normal.Y normal.Z shadow.B shadow.G shadow.R";
    assert_eq!(names.join(" "), expected);
    assert_eq!(meta.headers.len(), 1);
}

#[test]
fn png_is_srgb_of_exposed_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let mut film = Film::new(2, 2).unwrap();
    let values = vec![0.25, 0.0, 2.0, f32::NAN, -1.0, 0.5, 0.125, f32::INFINITY, 0.0, 0.0, 0.0, 0.0];
    film.add_layer_with("beauty", RGB, values).unwrap();
    write(&path, &film, 1.0).unwrap();
    let first = fs::read(&path).unwrap();
    let decoded = image::open(&path).unwrap().into_rgb8();
    assert_eq!(decoded.as_raw()[..9], [188, 0, 255, 0, 0, 255, 137, 255, 0]);
    let back = read(&path).unwrap();
    assert!((back.layer("beauty").unwrap().values()[0] - 0.5).abs() < 0.003);
    // Reading and writing without exposure changes nothing.
    write(&path, &back, 0.0).unwrap();
    assert_eq!(fs::read(&path).unwrap(), first);
    let no_colour = write_png(&path, &self::film(8, 8), "depth", 0.0).unwrap_err();
    assert_eq!(no_colour.to_string(), "layer 'depth' with channels Z cannot be shown in colour");
    assert_eq!(fs::read(&path).unwrap(), first);
}

#[test]
fn heat_maps_span_the_finite_values() {
    let folder = tempfile::tempdir().unwrap();
    let (heat, grey) = (folder.path().join("heat.png"), folder.path().join("grey.png"));
    let mut film = Film::new(4, 1).unwrap();
    film.add_layer_with("cost", GREY, vec![10.0, 30.0, f32::INFINITY, f32::NAN]).unwrap();
    let range = write_heat_map(&heat, &film, "cost", ColorMap::Viridis, None).unwrap();
    assert_eq!(range, ValueRange { min: 10.0, max: 30.0 });
    let pixels = image::open(&heat).unwrap().into_rgb8();
    assert_eq!(pixels.as_raw()[..], [68, 1, 84, 253, 231, 37, 253, 231, 37, 128, 128, 128]);
    assert_eq!(write_grey(&grey, &film, "cost", None).unwrap(), range);
    assert_eq!(image::open(&grey).unwrap().into_luma8().as_raw()[..], [0, 255, 255, 0]);
    let fixed = ValueRange { min: 0.0, max: 40.0 };
    assert_eq!(write_grey(&grey, &film, "cost", Some(fixed)).unwrap(), fixed);
    assert_eq!(image::open(&grey).unwrap().into_luma8().as_raw()[..], [64, 191, 255, 0]);
    let two = write_grey(&grey, &self::film(8, 8), "beauty", None).unwrap_err();
    assert!(matches!(two, ImageError::Channels { .. }));
}

#[test]
fn damaged_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let good = encode_exr(&film(40, 40)).unwrap();
    let png = encode_png(40, 40, &[[7, 8, 9]; 1600]).unwrap();
    let mut cases: Vec<(&str, Vec<u8>)> =
        vec![("a.exr", b"garbage".to_vec()), ("a.png", b"garbage".to_vec())];
    cases.extend((0..8).map(|i| ("a.exr", good[..good.len() * i / 8].to_vec())));
    cases.extend((0..8).map(|i| ("a.png", png[..png.len() * i / 8].to_vec())));
    cases.push(("a.exr", png.clone()));
    cases.push(("a.png", good.clone()));
    for (name, bytes) in cases {
        let path = folder.path().join(name);
        fs::write(&path, &bytes).unwrap();
        let error = read(&path).expect_err(&format!("{name} of {} bytes", bytes.len()));
        assert!(matches!(error, ImageError::Decode { .. }), "{error:?}");
        assert!(error.to_string().starts_with(path.to_str().unwrap()), "{error}");
        assert!(!error.to_string().contains('\n'), "{error}");
    }
    for name in ["none.exr", "none.png"] {
        assert!(matches!(read(&folder.path().join(name)), Err(ImageError::Io { .. })));
    }
    let folder_as_image = folder.path().join("folder.exr");
    fs::create_dir(&folder_as_image).unwrap();
    assert!(matches!(read(&folder_as_image), Err(ImageError::Io { .. })));
}

/// The header's data window says 100000 x 100000 pixels.
#[test]
fn promises_of_absurd_size_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut bytes = encode_exr(&film(40, 40)).unwrap();
    let key = b"dataWindow\0box2i\0";
    let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() + 4 + 8;
    bytes[at..at + 4].copy_from_slice(&99_999_i32.to_le_bytes());
    bytes[at + 4..at + 8].copy_from_slice(&99_999_i32.to_le_bytes());
    fs::write(&path, &bytes).unwrap();
    assert!(matches!(read(&path), Err(ImageError::Decode { .. })));
}

#[test]
fn writability_is_known_before_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    assert_eq!(check_writable(&at("a.exr")).unwrap(), Format::Exr);
    assert_eq!(check_writable(&at("a.Png")).unwrap(), Format::Png);
    assert!(names_in(folder.path()).is_empty());
    fs::create_dir(at("folder.exr")).unwrap();
    assert!(matches!(check_writable(&at("folder.exr")), Err(ImageError::IsFolder { .. })));
    assert!(matches!(write_exr(&at("folder.exr"), &film(8, 8)), Err(ImageError::IsFolder { .. })));
    for name in ["a.jpg", "a", "exr", ".exr", "a.exr.gz"] {
        assert!(matches!(check_writable(&at(name)), Err(ImageError::Extension { .. })), "{name}");
    }
    assert!(matches!(check_writable(&at("none/a.exr")), Err(ImageError::Folder { .. })));
    fs::write(at("file"), "").unwrap();
    assert!(matches!(check_writable(&at("file/a.exr")), Err(ImageError::Folder { .. })));
    assert!(matches!(check_part_writable(&at("a.png")), Err(ImageError::PartExtension { .. })));
    assert!(check_part_writable(&at("a.exr")).is_ok());
    assert!(check_writable(Path::new("a.exr")).is_ok());
    assert_eq!(names_in(folder.path()), ["file", "folder.exr"]);
}

#[test]
fn a_failed_write_keeps_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &film(16, 16)).unwrap();
    let old = fs::read(&path).unwrap();
    assert!(write_exr(&path, &Film::new(1, 1).unwrap()).is_err());
    assert_eq!(fs::read(&path).unwrap(), old);
    write_exr(&path, &film(16, 17)).unwrap();
    assert_ne!(fs::read(&path).unwrap(), old);
    assert_eq!(names_in(folder.path()), ["a.exr"]);
}

fn part(index: u32, count: u32) -> Part {
    let shard = Shard::new(index, count).unwrap();
    Part { shard, tile_size: 16, fingerprint: 0xdead_beef_0123_4567, exposure: 0.1 }
}

/// Parts of `film`, with rubbish in the tiles of other shards.
fn write_parts(folder: &Path, film: &Film, count: u32) -> Vec<PathBuf> {
    let grid = TileGrid::new(film.width(), film.height(), 16).unwrap();
    (1..=count)
        .map(|index| {
            let path = folder.join(format!("part{index}.exr"));
            let part = part(index, count);
            let mut shard = film.clone();
            shard.layers_mut().iter_mut().for_each(|layer| layer.values_mut().fill(-7.0));
            part.shard.tiles(&grid).unwrap().for_each(|i| shard.copy_tile(film, &grid.tile(i)));
            write_part(&path, &shard, &part).unwrap();
            assert_eq!(read_part(&path).unwrap(), (part, (film.width(), film.height())));
            path
        })
        .collect()
}

#[test]
fn merged_parts_are_the_whole_image() {
    let folder = tempfile::tempdir().unwrap();
    let film = film(70, 41);
    let whole = encode_exr(&film).unwrap();
    for count in [1, 2, 5, 15] {
        let mut parts = write_parts(folder.path(), &film, count);
        parts.reverse();
        let merged = merge(&parts).unwrap();
        assert!(merged.film.same_bits(&film), "{count}");
        assert!(encode_exr(&merged.film).unwrap() == whole, "{count}");
        assert_eq!((merged.exposure, merged.fingerprint), (0.1, 0xdead_beef_0123_4567));
    }
}

#[test]
fn parts_that_do_not_fit_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let image = film(70, 41);
    let parts = write_parts(folder.path(), &image, 3);
    let fails = |parts: &[PathBuf], message: &str| {
        let error = merge(parts).unwrap_err().to_string();
        assert!(error.contains(message) && !error.contains('\n'), "{error}");
    };
    fails(&[], "no parts");
    fails(&parts[..2], "of 3 shards, 1 is missing: 3");
    fails(&parts[1..2], "of 3 shards, 2 are missing: 1, 3");
    let copy = folder.path().join("copy.exr");
    fs::copy(&parts[1], &copy).unwrap();
    fails(&[&parts[..], std::slice::from_ref(&copy)].concat(), "holds shard 2/3, and so does");
    let with_third = |film: &Film, part: &Part| {
        write_part(&copy, film, part).unwrap();
        vec![parts[0].clone(), parts[1].clone(), copy.clone()]
    };
    let third = part(3, 3);
    fails(&with_third(&image, &Part { fingerprint: 1, ..third }), "differ in scene or settings");
    fails(&with_third(&image, &Part { tile_size: 8, ..third }), "differ in tile size");
    fails(&with_third(&image, &Part { exposure: 0.2, ..third }), "differ in exposure");
    fails(&with_third(&image, &part(3, 4)), "differ in the number of shards");
    fails(&with_third(&film(70, 42), &third), "copy.exr: does not fit to");
    let mut fewer = Film::new(70, 41).unwrap();
    fewer.add_layer("ao", GREY).unwrap();
    fails(&with_third(&fewer, &third), "differ in layers");
    write_exr(&copy, &image).unwrap();
    fails(&[parts[0].clone(), parts[1].clone(), copy.clone()], "copy.exr: is not a part of an image");
    fails(&[folder.path().join("none.exr")], "none.exr");
    fails(&[folder.path().join("none.png")], "must be an .exr file");
    let too_many = Part { tile_size: 100, ..part(1, 2) };
    write_part(&copy, &image, &too_many).unwrap();
    fails(std::slice::from_ref(&copy), "2 shards are more than the image's 1 tiles");
    assert!(write_part(&copy, &image, &Part { exposure: f32::NAN, ..third }).is_err());
    assert!(write_part(&folder.path().join("a.png"), &image, &third).is_err());
}
