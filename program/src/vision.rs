//! `downbeat vision`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use downbeat_vision::{Class, Colours, Encoding, Picture, Samples, Table, classified};
use serde::Deserialize;

use super::bag;
use super::new_output::{Force, Output};
use super::unfinished::write_file;
use downbeat_bags::Selection;
use downbeat_files::toml::Source;
use downbeat_files::user_file;
use downbeat_msgs::Message;
use downbeat_msgs::cdr;
use downbeat_msgs::sensor_msgs::msg::Image;

#[derive(Subcommand)]
pub(crate) enum VisionCommand {
    /// Learn the colours of ball, goals, carpet, lines and teams from marks in pictures (docs/vision.md).
    Calibrate(CalibrateArguments),
}

#[derive(Args)]
pub(crate) struct CalibrateArguments {
    /// What is where in which pictures: [[picture]] with file = "a.png", or bag, topic and at; and for each
    /// of orange, yellow, green, white, blue and red discs [x, y, radius] in pixels.
    #[arg(value_name = "MARKS.toml")]
    marks: PathBuf,
    /// The new file of colours, for the setting `colours` of modules of the kind vision.
    #[arg(long, short, value_name = "COLOURS.toml")]
    output: PathBuf,
    /// Start from these colours instead of the built-in ones: they stay those of classes without marks.
    #[arg(long, value_name = "COLOURS.toml")]
    from: Option<PathBuf>,
    /// Write each picture, and beside it its classes, as PNG into this directory.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// A file of marks.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Marks {
    picture: Vec<MarkedPicture>,
}

/// A picture in a file, or in a bag, relative to the file of marks.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MarkedPicture {
    file: Option<PathBuf>,
    bag: Option<PathBuf>,
    topic: Option<String>,
    /// In s since the bag begins; the first picture from then on.
    #[serde(default)]
    at: f64,
    /// Discs: x, y and radius in pixels.
    #[serde(default)]
    orange: Vec<[f64; 3]>,
    #[serde(default)]
    yellow: Vec<[f64; 3]>,
    #[serde(default)]
    green: Vec<[f64; 3]>,
    #[serde(default)]
    white: Vec<[f64; 3]>,
    #[serde(default)]
    blue: Vec<[f64; 3]>,
    #[serde(default)]
    red: Vec<[f64; 3]>,
}

/// Red, green and blue, row by row.
struct Pixels {
    size: [u32; 2],
    rgb: Vec<u8>,
}

/// The largest picture, in bytes.
const LARGEST: usize = 64 << 20;

pub(crate) fn run(command: &VisionCommand) -> anyhow::Result<()> {
    match command {
        VisionCommand::Calibrate(arguments) => calibrate(arguments),
    }
}

fn calibrate(arguments: &CalibrateArguments) -> anyhow::Result<()> {
    arguments.force.check(Output::File, &arguments.output)?;
    let before = match &arguments.from {
        Some(path) => Colours::read(path)?,
        None => Colours::default(),
    };
    let marks = read_marks(&arguments.marks)?;
    let folder = arguments.marks.parent().unwrap_or(Path::new(""));
    let mut samples = Samples::default();
    let mut pictures = Vec::new();
    for (number, marked) in (1..).zip(&marks.picture) {
        let place = || format!("{}: picture {number}", arguments.marks.display());
        let pixels = marked.read(folder).with_context(place)?;
        marked.add_to(&mut samples, &pixels).with_context(place)?;
        pictures.push(pixels);
    }
    let colours = samples.learn(before).with_context(|| arguments.marks.display().to_string())?;
    arguments.force.make_way(Output::File, &arguments.output, [arguments.marks.as_path()])?;
    write_file(&arguments.output, colours.to_text())?;
    println!("{}: {} pictures", arguments.output.display(), pictures.len());
    let table = Table::new(&colours);
    for (number, pixels) in (1..).zip(&pictures) {
        let picture = pixels.picture()?;
        println!("picture {number}: {}", shares(&picture, &table));
        if let Some(folder) = &arguments.pictures {
            write_beside(folder, number, &picture, pixels, &table)?;
        }
    }
    Ok(())
}

fn read_marks(path: &Path) -> anyhow::Result<Marks> {
    let marks: Marks = Source::read(path, "the marks", user_file::LARGEST)?.parse()?;
    if marks.picture.is_empty() {
        bail!("{} has no [[picture]]", path.display());
    }
    Ok(marks)
}

impl MarkedPicture {
    fn read(&self, folder: &Path) -> anyhow::Result<Pixels> {
        match (&self.file, &self.bag, &self.topic) {
            (Some(file), None, None) => {
                let path = folder.join(file);
                read_png(&path).with_context(|| path.display().to_string())
            }
            (None, Some(bag), Some(topic)) => {
                let path = folder.join(bag);
                of_bag(&path, topic, self.at).with_context(|| path.display().to_string())
            }
            _ => bail!("a picture is given by file, a PNG, or by bag and topic, and at in s"),
        }
    }

    fn add_to(&self, samples: &mut Samples, pixels: &Pixels) -> anyhow::Result<()> {
        let picture = pixels.picture()?;
        let [width, height] = pixels.size.map(f64::from);
        let classes = [
            (Class::Orange, "orange", &self.orange),
            (Class::Yellow, "yellow", &self.yellow),
            (Class::Green, "green", &self.green),
            (Class::White, "white", &self.white),
            (Class::Blue, "blue", &self.blue),
            (Class::Red, "red", &self.red),
        ];
        for (class, name, discs) in classes {
            for [x, y, radius] in discs {
                if !(0.0..width).contains(x) || !(0.0..height).contains(y) || !(0.5..=1000.0).contains(radius)
                {
                    bail!(
                        "{name} at [{x}, {y}, {radius}] is no disc in a picture of {width} x {height} pixels: x and y are its middle, and the radius is at least 0.5"
                    );
                }
                samples.add(&picture, class, [*x, *y], *radius);
            }
        }
        Ok(())
    }
}

fn read_png(path: &Path) -> anyhow::Result<Pixels> {
    let file = std::io::BufReader::new(user_file::open(path)?);
    let mut decoder = png::Decoder::new_with_limits(file, png::Limits { bytes: LARGEST });
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info()?;
    let length = reader.output_buffer_size().filter(|length| *length <= LARGEST);
    let mut data = vec![0; length.context("the picture is too large")?];
    let info = reader.next_frame(&mut data)?;
    data.truncate(info.buffer_size());
    let rgb = match info.color_type {
        png::ColorType::Rgb => data,
        png::ColorType::Rgba => {
            data.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
        }
        _ => bail!("the picture has no colours"),
    };
    Ok(Pixels { size: [info.width, info.height], rgb })
}

fn of_bag(path: &Path, name: &str, at: f64) -> anyhow::Result<Pixels> {
    let reader = bag::open(path)?;
    let name = format!("/{}", name.trim_start_matches('/'));
    let topic = reader.topic(&name).with_context(|| {
        let names: Vec<&str> = reader.topics().iter().map(|topic| topic.info.name.as_str()).collect();
        format!("it has no topic {name}; there are {}", names.join(", "))
    })?;
    let of_topic = &reader.topics()[topic.index()].info.type_name;
    if of_topic != Image::TYPE_NAME {
        bail!("{name} is of type {of_topic}; pictures are {}", Image::TYPE_NAME);
    }
    let start = reader.start_time().unwrap_or_default();
    let from = start.saturating_add((at * 1e9) as i64);
    let mut messages = reader.messages(Selection::all().topics([topic]).from(from))?;
    let message = messages.next().with_context(|| format!("{name} has no message from {at} s on"))??;
    let image: Image = cdr::from_slice(&message.data).with_context(|| name.clone())?;
    let picture = Picture::of(&image)?.with_colours()?;
    Ok(Pixels { size: [image.width, image.height], rgb: picture.to_rgb() })
}

impl Pixels {
    fn picture(&self) -> anyhow::Result<Picture<'_>> {
        Ok(Picture::new(self.size, 3 * self.size[0] as usize, Encoding::Rgb8, &self.rgb)?)
    }
}

/// How much of a picture belongs to each class.
fn shares(picture: &Picture<'_>, table: &Table) -> String {
    let mut counts = [0_u32; 7];
    picture.each_pixel(|_, rgb| counts[table.class_of(rgb) as usize] += 1);
    let all = f64::from(counts.iter().sum::<u32>());
    let share =
        |class: Class, name: &str| format!("{:.1} % {name}", 100.0 * f64::from(counts[class as usize]) / all);
    [
        share(Class::Green, "green"),
        share(Class::White, "white"),
        share(Class::Orange, "orange"),
        share(Class::Yellow, "yellow"),
        share(Class::Blue, "blue"),
        share(Class::Red, "red"),
        share(Class::Other, "nothing"),
    ]
    .join(", ")
}

fn write_beside(
    folder: &Path,
    number: usize,
    picture: &Picture<'_>,
    pixels: &Pixels,
    table: &Table,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    for (name, rgb) in [("picture", &pixels.rgb), ("classes", &classified(picture, table))] {
        let path = folder.join(format!("{name}_{number}.png"));
        write_png(&path, pixels.size, rgb).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

fn write_png(path: &Path, [width, height]: [u32; 2], rgb: &[u8]) -> anyhow::Result<()> {
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    Ok(writer.finish()?)
}
