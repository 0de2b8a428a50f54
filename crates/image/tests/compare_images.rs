//! Comparing images: known differences, values that are no numbers, stable JSON, difference pictures.

use umbrage_image::compare::*;
use umbrage_image::*;

fn film(beauty: Vec<f32>, depth: Vec<f32>) -> Film {
    let mut film = Film::new(4, 2).unwrap();
    film.add_layer_with("depth", Z, depth).unwrap();
    film.add_layer_with("beauty", RGB, beauty).unwrap();
    film
}

#[test]
fn known_differences_are_measured() {
    let a = film(vec![0.5; 24], vec![1.0; 8]);
    let mut changed = vec![0.5; 24];
    changed[5 * 3] = 0.75;
    changed[6 * 3 + 1] = 0.375;
    let b = film(changed, vec![1.0; 8]);
    let result = compare(&a, &b, &CompareOptions::default()).unwrap();
    let main = &result.main;
    assert_eq!((main.layer.as_str(), main.different_pixels, main.non_finite_pixels), ("beauty", 2, 0));
    assert_eq!((main.max_abs, main.max_at), (0.25, Some([1, 1])));
    assert!((main.bias - 0.125 / 24.0).abs() < 1e-15);
    assert!((main.mean_abs - 0.375 / 24.0).abs() < 1e-15);
    assert!((main.rmse - ((0.0625 + 0.015_625) / 24.0f64).sqrt()).abs() < 1e-15);
    assert!(main.flip.unwrap() > 0.0 && main.flip.unwrap() < main.flip_max.unwrap());
    assert!(!result.identical);
    let depth = &result.layers[0];
    assert_eq!((depth.layer.as_str(), depth.different_pixels, depth.max_at), ("depth", 0, None));
    assert_eq!(depth.flip, None);
    let reverse = compare(&b, &a, &CompareOptions::default()).unwrap().main;
    assert_eq!((reverse.bias, reverse.rmse, reverse.flip), (-main.bias, main.rmse, main.flip));
    let only_depth = compare(&a, &b, &CompareOptions::default().with_layer("depth")).unwrap();
    assert_eq!((only_depth.main.layer.as_str(), only_depth.identical), ("depth", true));
}

#[test]
fn values_that_are_no_numbers_have_a_meaning() {
    let (inf, nan) = (f32::INFINITY, f32::NAN);
    let a = film(vec![0.0; 24], vec![inf, nan, -inf, inf, nan, 1.0, 1.0, 0.0]);
    let b = film(vec![0.0; 24], vec![inf, nan, -inf, -inf, 1.0, inf, 3.0, -0.0]);
    let result = compare(&a, &b, &CompareOptions::default().with_layer("depth")).unwrap();
    let depth = &result.main;
    assert_eq!((depth.different_pixels, depth.non_finite_pixels), (4, 3));
    assert_eq!((depth.max_abs, depth.max_at), (2.0, Some([2, 1])));
    assert_eq!(depth.bias, 2.0 / 5.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("d.png");
    let options = CompareOptions::default().with_layer("depth");
    let range = write_difference(&path, &a, &b, &options, DifferencePicture::Signed).unwrap();
    assert_eq!(range, ValueRange { min: -2.0, max: 2.0 });
    let pixels = image::open(&path).unwrap().into_rgb8();
    assert_eq!(pixels.get_pixel(0, 0).0, [255; 3]);
    assert_eq!(pixels.get_pixel(3, 0).0, [128; 3]);
    assert_eq!(pixels.get_pixel(2, 1).0, [103, 0, 31]);
    let flip = write_difference(&path, &a, &b, &options, DifferencePicture::Flip);
    assert!(matches!(flip, Err(CompareError::NoColor(_))));
    let beauty = write_difference(&path, &a, &b, &CompareOptions::default(), DifferencePicture::Flip);
    assert_eq!(beauty.unwrap(), ValueRange::UNIT);
    assert!(image::open(&path).unwrap().into_rgb8().pixels().all(|p| p.0 == [0, 0, 4]));
}

#[test]
fn json_keys_are_stable() {
    let a = film(vec![0.0; 24], vec![f32::INFINITY; 8]);
    let mut b = film(vec![1.0; 24], vec![0.0; 8]);
    b.add_layer("ao", GREY).unwrap();
    let result = compare(&a, &b, &CompareOptions::default()).unwrap();
    let json = serde_json::to_string(&result).unwrap();
    let numbers = concat!(
        r#""layer":"beauty","channels":["R","G","B"],"rmse":1.0,"mean_abs":1.0,"max_abs":1.0,"#,
        r#""max_at":[0,0],"bias":1.0,"different_pixels":8,"non_finite_pixels":0,"flip":"#
    );
    assert!(json.starts_with(&format!(r#"{{"width":4,"height":2,"identical":false,{numbers}"#)), "{json}");
    let depth = concat!(
        r#""layers":[{"layer":"depth","channels":["Z"],"rmse":0.0,"mean_abs":0.0,"max_abs":0.0,"#,
        r#""max_at":null,"bias":0.0,"different_pixels":8,"non_finite_pixels":8,"flip":null,"flip_max":null},"#
    );
    assert!(json.contains(depth), "{json}");
    assert!(json.ends_with(r#""only_in_a":[],"only_in_b":["ao"]}"#), "{json}");
    let text = result.to_string();
    assert!(text.starts_with("4 x 2 pixels, different\ndepth ") && text.ends_with("only in the second: ao"));
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let a = film(vec![0.0; 24], vec![0.0; 8]);
    let options = CompareOptions::default();
    let mut small = Film::new(3, 2).unwrap();
    small.add_layer("beauty", RGB).unwrap();
    let size = compare(&a, &small, &options).unwrap_err();
    assert_eq!(size.to_string(), "images of 4 x 2 and 3 x 2 pixels cannot be compared");
    let mut other = Film::new(4, 2).unwrap();
    other.add_layer("beauty", GREY).unwrap();
    assert!(matches!(compare(&a, &other, &options), Err(CompareError::NothingInCommon(_))));
    let missing = compare(&a, &other, &options.clone().with_layer("depth")).unwrap_err();
    assert_eq!(missing.to_string(), "there is no layer 'depth', only beauty");
    assert!(matches!(
        compare(&a, &a, &options.clone().with_exposure(f32::NAN)),
        Err(CompareError::Exposure(_))
    ));
    let folder = tempfile::tempdir().unwrap();
    let (exr, png) = (folder.path().join("a.exr"), folder.path().join("a.png"));
    write(&exr, &a, 0.0).unwrap();
    write(&png, &a, 0.0).unwrap();
    let mixed = compare_files(&exr, &png, &options).unwrap_err();
    assert!(matches!(mixed, CompareError::Formats { .. }), "{mixed}");
    assert!(compare_files(&exr, &exr, &options).unwrap().identical);
    assert!(compare_files(&png, &png, &options).unwrap().identical);
    let to_exr = write_difference(&exr, &a, &a, &options, DifferencePicture::Signed);
    assert!(matches!(to_exr, Err(CompareError::Image(ImageError::Extension { .. }))));
}

#[test]
fn exposure_changes_what_is_visible_only() {
    let dark = |v: f32| film(vec![v; 24], vec![0.0; 8]);
    let (a, b) = (dark(0.001), dark(0.002));
    let options = CompareOptions::default();
    let as_is = compare(&a, &b, &options).unwrap().main;
    let bright = compare(&a, &b, &options.with_exposure(8.0)).unwrap().main;
    assert_eq!(as_is.rmse, bright.rmse);
    assert!(bright.flip.unwrap() > 2.0 * as_is.flip.unwrap());
}
